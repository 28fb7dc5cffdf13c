"""The control panel of a page: its widgets, their events, and the state as HTML, never by colour alone."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from html import escape
from typing import Any

import numpy as np

from spm_pin.display.viewer.model import SessionState, ViewerModel, reading_units
from spm_pin.display.viewer.robot_scene import LOAD, VIEWS, WARN, Colour
from spm_pin.display.viewer.stage_model import StageModel, StageState
from spm_pin.display.writing import fixed

State = SessionState | StageState
"""A state of either machine."""
_LAYERS = {
    "Other branches": ("ghosts", False),
    "Leg names": ("names", True),
    "Trail of o": ("trail", True),
    "Forces held": ("forces", False),
    "Gizmo": ("gizmo", True),
    "The paper's shell": ("shell", False),
    "Points reached": ("points", False),
}
"""Layers of the scene by label: name of the layer, and whether it is shown initially."""
_OF_ROBOTS = {"ghosts", "forces", "shell", "points"}
"""Layers that a stage alone does not have."""
_NONE = "–"
# viser derives the colour of its buttons from these: light ones on a dark page, and white text on both.
_BRAND = {False: (0, 54, 84), True: (0, 114, 178)}
_CALM, _GREY, _STAGES = (0, 158, 115), (128, 128, 128), ((0, 114, 178), (230, 159, 0))
_BOX = "padding:0.35em 1em 0.35em 0.6em;font-size:0.8rem;line-height:1.4;font-variant-numeric:tabular-nums"
# One grid for all rows: a column is as wide as its widest text, and the bars take the rest.
_GRID = "display:grid;grid-template-columns:{columns};gap:0.15em 0.6em;align-items:center;white-space:nowrap"
_TRACK = "position:relative;height:0.62em;border-radius:0.3em;background:rgba(128,128,128,0.28);overflow:hidden"
_RIGHT = "text-align:right"

Report = Callable[[str, Any], Coroutine[Any, Any, None]]


class Panel:
    """The widgets of one client of a `Viewer`, added to a `viser.GuiApi`.

    `report` is called with the name and the value of every event, `model` is the session's. On the `narrow` page of a
    phone the instruments have a tab of their own.
    """

    def __init__(self, gui: Any, viewer: Any, model: ViewerModel | StageModel, report: Report, *, narrow: bool) -> None:
        self.gui, self.model, self._report = gui, model, report
        machine, is_robot = viewer.start.machine, isinstance(model, ViewerModel)
        limits = machine.limits
        self.theme(viewer.dark)
        gui.main_panel.dock_right()
        self.status = gui.add_html("")
        options: dict[str, Any] = {"visible": False, "color": (200, 16, 46), "icon": "arrow-back-up"}
        self.back = self._add("button", "back", "Back to the reachable pose", **options)
        hint = "Or show the other branches as ghosts and click one"
        self.branch = self._add("dropdown", "branch", "Branch", [_NONE], hint=hint, visible=is_robot)
        self._add("button_group", "view", "View", tuple(VIEWS))
        if not narrow:
            self.instruments = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Pose"):
            self.angles = next(iter(model.conventions))
            self.pose_sliders = self._add_sliders("coordinate", model.conventions[self.angles])
            self._add("dropdown", "angles", "Angles", list(model.conventions), hint=model.hint)
            hint = "A leg within its limits is kept within them"
            self._add("checkbox", "hold", "Hold leg limits", True, visible=limits is not None, hint=hint)
            self._add("button", "reset", "Start pose", icon="home")
            if viewer.demo is not None:
                self._add("button", "play", "Demo motion", icon="player-play")
        with tabs.add_tab("Legs"):
            units = reading_units(machine)
            self._factors = np.array([unit.factor for unit in units])
            labels = [f"{leg} [{unit.name}]" for leg, unit in zip(machine.legs.names, units, strict=True)]
            self.leg_sliders = self._add_sliders("leg", labels)
        if narrow:
            with tabs.add_tab("Instruments"):
                self.instruments = gui.add_html("")
        with tabs.add_tab("Load"):
            zero = (0.0, 0.0, 0.0)
            self.force = self._add("vector3", "load", "Force [N]", zero, step=10.0, hint="Onto m at o, in {B}")
            self.moment = self._add("vector3", "load", "Moment [N m]", zero, step=10.0, hint="Onto m, in {B}")
            self.forces = gui.add_html("")
        with tabs.add_tab("Show"):
            is_bounded = limits is not None and bool(np.isfinite(limits.maximum).all())
            hidden = set() if is_robot else _OF_ROBOTS
            if not (is_bounded and machine.is_nominal):
                hidden = hidden | {"shell"}
            for label, (layer, shown) in _LAYERS.items():
                self._add("checkbox", "layer", label, shown, key=layer, visible=layer not in hidden)
            self._add("checkbox", "dark", "Dark page", viewer.dark)
        if viewer.recording is not None:
            duration = float(viewer.recording.times[-1])
            with tabs.add_tab("Path"):
                self._add("button", "play", "Play / pause", icon="player-play")
                self.time = self._add("slider", "time", "Time [s]", 0.0, duration, max(duration / 1000.0, 1e-6), 0.0)
                self.path_note = gui.add_html("")
        with tabs.add_tab("Share"):
            self._add("button", "png", "Save picture (PNG)", icon="photo")
            self._add("button", "json", "Save state (JSON)", icon="download")
            self.command = gui.add_text("Command", "", multiline=True)
            hint = "Joint values in Pinocchio's order [rad, m]" if is_robot else f"[{machine.legs.units[0]}]"
            self.q = gui.add_text(model.values_name, "", multiline=True, hint=hint)

    def theme(self, dark: bool) -> None:
        """Make the page dark or light."""
        self.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_width="large", brand_color=_BRAND[dark]
        )

    def _add(self, kind: str, event: str, label: str, *arguments: Any, key: Any = None, **options: Any) -> Any:
        """Add a widget of a kind, whose events are reported under a name, with its value or with `key` and value."""
        widget = getattr(self.gui, f"add_{kind}")(label, *arguments, **options)

        async def on_event(message: Any) -> None:
            # A value set by the server comes back as an event without a client.
            if message.client_id is not None:
                value = message.target.value
                if kind == "slider":
                    value = float(min(max(value, message.target.min), message.target.max))
                await self._report(event, value if key is None else (key, value))

        register = widget.on_click if kind.startswith("button") else widget.on_update
        register(on_event)
        return widget

    def _add_sliders(self, event: str, labels: Sequence[str]) -> list[Any]:
        steps = [0.001 if "[m]" in label else 0.1 for label in labels]
        return [self._add("slider", event, labels[k], 0.0, 1.0, steps[k], 0.0, key=k) for k in range(len(labels))]

    def show(self, state: State, moved: tuple[str, int]) -> None:
        """Show a state.

        The slider that the user moves, "coordinate" or "leg" with its number, is not changed; neither are the values
        of the others of its kind.
        """
        self.status.content = status(state, self.angles)
        self.instruments.content = instruments(state)
        self.forces.content = forces_table(state)
        self.back.visible = state.distance > 0.0
        labels = state.labels or (_NONE,)
        if tuple(self.branch.options) != labels:
            self.branch.options = labels
        self.branch.value = state.label or labels[0]
        # If angles are not unique, those of the state shown are kept.
        pose = self.model.coordinates(state.target if state.distance > 0.0 else state.shown.pose, self.angles)
        readings = state.shown.readings
        kinds = (
            ("coordinate", self.pose_sliders, pose, self.model.pose_ranges(self.angles)),
            ("leg", self.leg_sliders, readings * self._factors, self.model.reading_ranges() * self._factors[:, None]),
        )
        for kind, sliders, values, ranges in kinds:
            for k, (slider, value, (low, high)) in enumerate(zip(sliders, values, ranges, strict=True)):
                if (kind, k) != moved:
                    value = slider.value if kind == moved[0] else float(value)
                    _set_slider(slider, value, min(low, value), max(high, value))
        self.command.value = self.model.command()
        self.q.value = np.array2string(self.model.values() + 0.0, precision=9, separator=", ", max_line_width=60)

    def set_angles(self, angles: str) -> None:
        """Take another convention of the angles; `show` sets their values."""
        self.angles = angles
        for slider, name in zip(self.pose_sliders, self.model.conventions[angles], strict=True):
            slider.label = name

    def show_path(self, *lines: str) -> None:
        """Show lines of text below the path's controls."""
        self.path_note.content = note(*lines)


def _set_slider(slider: Any, value: float, low: float, high: float) -> None:
    """Set a slider's value and ends, rounded to its step; the ends outwards."""
    step = float(slider.step)
    digits = 3 if step < 0.01 else 1
    slider.min = round(np.floor(low / step + 1e-6) * step, digits) + 0.0
    slider.max = round(max(np.ceil(high / step - 1e-6) * step, low + step), digits) + 0.0
    slider.value = round(value, digits) + 0.0


def status(state: State, convention: str = "X-Y-X") -> str:
    """Return the branch, the position with the angles in a convention, and the notices."""
    tags = ["physical" if state.is_physical else "not physical"]
    if state.shown.machine.limits is not None:
        tags.append("within limits" if not state.shown.limit_excess.any() else "beyond limits")
    title = f'<b data-spm="branch">{escape(state.title)}</b> &nbsp;{escape(", ".join(tags))}'
    lines = [
        f'<div style="font-size:0.95rem">{title}</div>',
        f'<div data-spm="pose" style="opacity:0.75">{state.pose_text(convention)}</div>',
    ]
    for kind, sign, colour, texts in (("warning", "⚠", WARN, state.warnings), ("info", "ℹ", _GREY, state.notes)):
        style = f"border-left:3px solid rgb{colour};padding:0.1em 0 0.1em 0.5em;margin-top:0.3em"
        lines += [f'<div data-spm="{kind}" style="{style}">{sign} {escape(text)}</div>' for text in texts]
    return f'<div style="{_BOX}">{"".join(lines)}</div>'


def instruments(state: State) -> str:
    """Return the legs against their limits, and the distances from singularities."""
    return f'<div style="{_BOX}">{_legs(state)}{_singularities(state)}</div>'


def note(*lines: str) -> str:
    """Return lines of plain text."""
    return f'<div data-spm="note" style="{_BOX}">{"<br>".join(map(escape, lines))}</div>'


def _grid(columns: str, cells: list[str]) -> str:
    return f'<div style="{_GRID.format(columns=columns)}">{"".join(cells)}</div>'


def _cell(text: str, style: str = "", name: str = "") -> str:
    tag = f' data-spm="{name}"' if name else ""
    return f'<span{tag} style="{style}">{text}</span>'


def _bar(share: float, colour: Colour, ticks: tuple[float, ...] = (), side: str = "left", start: float = 0.0) -> str:
    """Return a track with a bar for a fraction of it, from its start on one side, and ticks at fractions."""
    marks = "".join(
        f'<div style="position:absolute;top:0;bottom:0;left:{100.0 * x:.1f}%;width:2px;background:currentColor"></div>'
        for x in ticks
    )
    filled = f"position:absolute;top:0;bottom:0;{side}:{100.0 * start:.1f}%;width:{100.0 * share:.1f}%"
    return f'<div style="{_TRACK}"><div style="{filled};background:rgb{colour};opacity:0.85"></div>{marks}</div>'


def _legs(state: State) -> str:
    machine, readings, cells = state.shown.machine, state.shown.readings, []
    legs, units, limits = machine.legs, reading_units(machine), machine.limits
    for k, (leg, reading, excess, unit) in enumerate(
        zip(legs.names, readings, state.shown.limit_excess, units, strict=True)
    ):
        # The track is the allowed range with a tenth on either side, so that a leg beyond it is visible.
        low, high = (limits.minimum[k], limits.maximum[k]) if limits is not None else (0.0, np.inf)
        ticks = tuple(share for share, limit in ((0.1, low), (0.9, high)) if limit != 0.0 and np.isfinite(limit))
        if not np.isfinite([low, high]).all():
            low, high = 0.0, 1.25 * float(np.abs(readings[3 * (k // 3) : 3 * (k // 3) + 3]).max())
        share = float(np.clip(0.1 + 0.8 * (reading - low) / max(high - low, 1e-12), 0.0, 1.0))
        colour = WARN if excess else _STAGES[k // 3]
        digits = 1 if unit.name == "°" else 0
        mark = f"⚠ {'+' if excess > 0.0 else '−'}{unit.difference(abs(excess), digits)}" if excess else ""
        value = _cell(unit.text(reading), _RIGHT, leg)
        cells += [_cell(leg), _bar(share, colour, ticks), value, _cell(mark, f"color:rgb{WARN};font-weight:600")]
    name = "Leg lengths" if legs.are_rps and not legs.offsets.any() else "Encoder readings"
    heading = f"in {' and '.join(dict.fromkeys(unit.name for unit in units))}{', between limits' if limits else ''}"
    return f"<div><b>{name}</b> {heading}</div>" + _grid("max-content minmax(3em,1fr) max-content max-content", cells)


def _singularities(state: State) -> str:
    measures = state.measures
    has_travel = any(measure.away for measure in measures)
    texts = ("", "", "away", "σ", "cond") if has_travel else ("", "", "", "σ", "")
    cells = [_cell(text, f"opacity:0.7;{_RIGHT}") for text in texts]
    for name, is_near, share, away, sigma, condition in measures:
        large = "" if condition is None else f"{condition:.3g}" if condition < 1e5 else "&gt;10⁵"
        cells += [
            _cell(f"{'⚠ ' if is_near else ''}{name}"),
            _bar(max(share, 0.02), WARN if is_near else _CALM),
            _cell(away, _RIGHT),
            _cell(fixed(sigma, 3), _RIGHT),
            _cell(large, _RIGHT),
        ]
    heading = f'<div style="margin-top:0.4em"><b>Singularities</b>{", in leg travel" * has_travel}</div>'
    return heading + _grid("max-content minmax(2em,1fr) max-content max-content max-content", cells)


def forces_table(state: State) -> str:
    """Return the leg forces that hold the load, as bars from the middle."""
    forces = state.forces
    if forces is None:
        return note("⚠ The legs cannot hold every load here.")
    largest = float(np.abs(forces).max())
    cells = []
    for leg, force in zip(state.shown.machine.legs.names, forces, strict=True):
        share = 0.5 * abs(force) / largest if largest > 0.0 else 0.0
        pushes = force >= 0.0
        bar = _bar(share, LOAD, side="left" if pushes else "right", start=0.5)
        sign = "" if abs(force) < 5e-4 else ("▲" if pushes else "▼")
        shown = fixed(force, 1) if abs(force) < 1e6 else f"{force:.3g}"
        cells += [_cell(leg), bar, _cell(shown, _RIGHT, f"force {leg}"), _cell(sign)]
    efforts = " and ".join(dict.fromkeys(kind.effort_unit for kind in state.shown.machine.legs.kinds))
    heading = f"<div><b>Leg forces</b> in {efforts}: ▲ pushes, ▼ pulls</div>"
    return f'<div style="{_BOX}">{heading}{_grid("max-content minmax(3em,1fr) max-content 1em", cells)}</div>'
