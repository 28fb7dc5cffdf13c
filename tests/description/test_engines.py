"""Readers of the URDF and the MJCF: check_urdf accepts them, and every engine shows the meshes where the tree is."""

from __future__ import annotations

import shutil
import subprocess
import sysconfig
from pathlib import Path
from xml.etree import ElementTree

import pytest
from description.kinematic_tree import TREE
from kinds_of_legs import SERVOS_AND_SCREWS as ROBOT

import spm_pin as spm
from spm_pin.description import Masses, urdf_text


@pytest.mark.parametrize("machine", [None, ROBOT], ids=["cylinders", "servos and screws"])
def test_check_urdf(machine: spm.Manipulator | None, tmp_path: Path) -> None:
    # Debian's liburdfdom-tools have it, and so does the urdfdom wheel that Pinocchio brings along.
    path = f"{sysconfig.get_path('scripts')}:/usr/local/bin:/usr/bin:/bin"
    binaries = {shutil.which("check_urdf", path=folder) for folder in path.split(":")} - {None}
    if not binaries:
        pytest.skip("check_urdf is not installed (Debian: liburdfdom-tools)")
    urdf = tmp_path / "spm.urdf"
    urdf.write_text(urdf_text(machine, prefix="left_", ros_constraints=machine is None), encoding="utf-8")
    for binary in binaries:
        answer = subprocess.run([str(binary), str(urdf)], capture_output=True, text=True, check=False)
        assert answer.returncode == 0, answer.stdout + answer.stderr
        assert answer.stderr == ""
        assert "Successfully Parsed XML" in answer.stdout
        assert machine or answer.stdout.count("child(") == 1 + len(TREE.joints)


@pytest.mark.parametrize(
    ("machine", "prefix"),
    [(None, "left_"), (spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11)), "")],
    ids=["robot", "stage"],
)
def test_the_root_for_ros_has_no_inertia_and_carries_the_base(machine: spm.Stage | None, prefix: str) -> None:
    masses = Masses(bodies={"*": {"mass": 0.1}})
    plain, rooted = (
        ElementTree.fromstring(urdf_text(machine, prefix=prefix, root=root, masses=masses)) for root in (False, True)
    )
    links = {link.get("name"): link for link in rooted.findall("link")}
    (root,) = links.keys() - {child.get("link") for child in rooted.iter("child")}
    assert root == f"{prefix}root"
    assert len(links.pop(root)) == 0
    assert list(links) == [link.get("name") for link in plain.findall("link")]
