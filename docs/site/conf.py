"""Sphinx's settings; `docs/site/build.py` gathers the pages and calls it."""

import itertools
import posixpath
import re
from types import GenericAlias
from typing import Any

import numpy.typing as npt
from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util.typing import stringify_annotation
from sphinx.writers.html5 import HTML5Translator

import spm_pin

project = "spm_pin"
author = "The spm_pin developers"
release = version = spm_pin.__version__

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
nitpicky = True
# Types of other projects: a link to them needs their inventories, and the build needs no network. And private ones,
# and type variables.
nitpick_ignore_regex = [
    (r"py:.*", r"(?!spm_pin\.).*"),
    (r"py:.*", r"spm_pin\..*\.(_\w+|[A-Z]|Kind|Limits|Scalar|State)"),
]
suppress_warnings = ["misc.highlighting_failure"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_output_stderr = "remove-warn"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
aliases = "BoolArray", "ComplexArray", "FloatArray", "IntArray", "PoseLike", "Progress"
autodoc_type_aliases = {name: name for name in aliases}
# Methods of our own bases are described with each class, not those of Python's.
foreign_bases = "BaseException, ImportError, Enum, int, str, dict, tuple, object"
autodoc_default_options = {"members": True, "show-inheritance": True, "inherited-members": foreign_bases}
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
numpydoc_xref_param_type = False
python_use_unqualified_type_names = True
python_display_short_literal_types = True
maximum_signature_line_length = 90
default_role = "code"

html_theme = "furo"
html_math_renderer = "mathml"  # browsers set it themselves: no script, nothing to fetch
html_title = f"spm_pin {version}"
html_static_path = ["static"]
html_css_files = ["extra.css"]
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False
copybutton_exclude = ".linenos, .gp, .go"
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#00588f", "color-brand-content": "#00588f"},
    "dark_css_variables": {"color-brand-primary": "#56b4e9", "color-brand-content": "#56b4e9"},
}


def _plain_text(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Keep |x| from being read as a substitution and lambda_ as a link: here they are what they look like."""
    for i, line in enumerate(lines):
        lines[i] = re.sub(
            r"`[^`]*`|\||(?<=\w)_(?!\w)", lambda found: found[0] if found[0][0] == "`" else f"\\{found[0]}", line
        )


def _skipped(app: Sphinx, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """Leave out aliases such as Colour = tuple[float, float, float], which autodoc takes for functions."""
    return True if isinstance(obj, GenericAlias) else None


def _short_signature(
    app: Sphinx, what: str, name: str, obj: object, options: object, arguments: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """Write type aliases by their names, and NumPy's `ArrayLike`, which annotations resolve to a long union."""
    union = stringify_annotation(npt.ArrayLike, "smart")

    def named(text: str | None) -> str | None:
        short = text and text.replace(union, "~numpy.typing.ArrayLike")
        return short and re.sub(r"~?[\w.]*TypeAliasForwardRef\('(\w+)'\)", r"\1", short)

    return named(arguments), named(result)


def _living_anchors(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: object) -> None:
    """Turn links of source pages to where a name is described: they have its module, the reference its public name."""
    if not page.startswith("_modules/"):
        return
    shown: dict[str, list[str]] = {}
    for entry in app.env.get_domain("py").objects.values():  # type: ignore[attr-defined]
        shown.setdefault(entry.docname, []).append(entry.node_id)

    def living(link: re.Match[str]) -> str:
        names = shown.get(posixpath.normpath(posixpath.join(posixpath.dirname(page), link["page"])), [])
        parts = link["name"].split(".")
        tails = [".".join(["", *parts[k:]]) for k in range(len(parts))]
        found = [name for tail in tails for name in names if f".{name}".endswith(tail)]
        return f'href="{link["page"]}.html{"#" + found[0] if found else ""}"'

    context["body"] = re.sub(r'href="(?P<page>[^"#:]*)\.html#(?P<name>spm_pin[\w.]*)"', living, context["body"])


def _formula(self: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Write a formula as MathML."""
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    text = convert(node.astext(), display=display)
    # As operators, det and bars would have the spaces of relations on both sides.
    text = text.replace('<mo movablelimits="true">det</mo>', '<mi>det</mi><mspace width="0.17em"/>')
    forms = itertools.cycle(("prefix", "postfix"))
    text = re.sub(
        r'<mo stretchy="false">&#x0007C;</mo>',
        lambda bar: f'<mo stretchy="false" form="{next(forms)}" lspace="0" rspace="0">|</mo>',
        text,
    )
    self.body.append(text)
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Connect the functions of this file."""
    app.add_html_math_renderer("mathml", (_formula, None), (_formula, None))
    app.connect("autodoc-process-docstring", _plain_text)
    app.connect("autodoc-process-signature", _short_signature)
    app.connect("autodoc-skip-member", _skipped)
    app.connect("html-page-context", _living_anchors)
