"""Write certified poses of the paper's machine: `python scripts/certified_dataset.py FOLDER`, some minutes.

Poses are drawn in leg space, with all real branches of each. A pose is kept if the number of its branches is proved,
and how far their joints can be from the exact ones. Files are NumPy arrays, a description, and their checksums, which
`sha256sum -c SHA256SUMS` compares.
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

import numpy as np

import spm_pin as spm
from spm_pin.crosscheck.random_poses import in_leg_space

CHUNK = 10_000
"""Poses solved at once."""

DESCRIPTION = """\
# {count} certified poses of the 3RPS-3SPR manipulator

Written by spm_pin {version}, `scripts/certified_dataset.py --count {count} --seed {seed}`.
E = {base} m, C = {platform} m, d = {side} m, legs within {limits} m.
Lengths in metres; frames and labels as in the documentation of spm_pin.

- `position.npy` ({count}, 3): the origin of the terminal platform in the base's frame.
- `rotation.npy` ({count}, 3, 3): its rotation matrix. Meant is the rotation of the quaternion that is made from the
  matrix's largest component.
- `leg_lengths.npy` ({count}, 8, 6): lower legs 1 to 3 and upper legs 1 to 3 of the branches {labels};
  NaN where a branch is not real.
- `error.npy` ({count}, 8): a bound of the error of these lengths, and of the distance of each middle joint from the
  exact one.
- `covered.npy` ({count}, 8): whether the branch is proved to be the only configuration of its six lengths that is
  joined to the home within the limits.

Proved for every pose: which branches are real, and that exactly one solution lies within each bound.
"""


def certified_poses(machine: spm.Manipulator, count: int, seed: int) -> dict[str, np.ndarray]:
    """Return the arrays of the data set."""
    rng = np.random.default_rng(seed)
    certificate = spm.certify(machine, machine.limits)
    parts: dict[str, list[np.ndarray]] = {}
    missing = count
    while missing > 0:
        poses = in_leg_space(machine, min(missing, CHUNK), rng)
        solutions = spm.inverse_displacement(machine, poses, certify=True)
        assert solutions.certain is not None
        assert solutions.radius is not None
        proved = np.isfinite(solutions.radius) | ~solutions.exists
        kept = proved.all(axis=-1) & solutions.certain.all(axis=-1)
        solutions, poses = solutions[kept], poses[kept]
        lengths = solutions.configurations.leg_lengths
        rows = {
            "position": poses.translation,
            "rotation": poses.rotation.as_matrix(),
            "leg_lengths": lengths,
            # A length is a distance from a joint; eight roundings cover its own.
            "error": solutions.radius + 8.0 * np.finfo(float).eps * lengths.max(axis=-1),
            "covered": certificate.covers(solutions.configurations),
        }
        for name, values in rows.items():
            parts.setdefault(name, []).append(np.asarray(values))
        missing -= int(kept.sum())
        print(f"{count - missing} of {count}", flush=True)
    return {name: np.concatenate(values) for name, values in parts.items()}


def write(folder: Path, count: int, seed: int) -> None:
    """Write the data set into a new folder."""
    folder.mkdir(parents=True)
    machine = spm.Manipulator.paper()
    for name, values in certified_poses(machine, count, seed).items():
        np.save(folder / f"{name}.npy", values)
    limits = f"{machine.limits.minimum[0]:g} to {machine.limits.maximum[0]:g}"
    text = DESCRIPTION.format(
        count=count,
        seed=seed,
        version=spm.__version__,
        base=f"{machine.base_radius:.17g}",
        platform=f"{machine.platform_radius:.17g}",
        side=f"{machine.middle_side:.17g}",
        limits=limits,
        labels=", ".join(spm.inverse_displacement(machine, in_leg_space(machine, 1, seed)).labels),
    )
    (folder / "README.md").write_text(text, encoding="utf-8")
    files = sorted(folder.iterdir())
    sums = [f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in files]
    (folder / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write certified poses of the paper's machine.")
    parser.add_argument("folder", type=Path, help="a folder that does not exist")
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    write(arguments.folder, arguments.count, arguments.seed)
