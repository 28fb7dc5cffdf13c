"""The generated files are fresh, the sources expand by hand, and every name takes the prefix."""

from __future__ import annotations

import re
import runpy
import subprocess
import sysconfig
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
import yaml
from description.kinematic_tree import SLIDES, KinematicTree, named_states
from error_fields import with_fields
from problems import in_leg_space, random_branches

import spm_pin as spm
from spm_pin.description import extended_urdf_text, urdf_text
from spm_pin.description.source_files import (
    ENTRY,
    EXTENDED_URDF,
    MESHES,
    MJCF,
    SDF,
    SRDF,
    URDF,
    description_directory,
    description_file,
    read_closures,
)
from spm_pin.description.tree import srdf_text
from spm_pin.description.visuals import read_obj
from spm_pin.errors import ArgumentError, DescriptionError

SCRIPTS = Path(__file__).parents[2] / "scripts"
PAPER = spm.Manipulator.paper()
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def shipped(name: str) -> str:
    return description_file(name).read_text(encoding="utf-8")


def test_generated_files_are_fresh() -> None:
    """Every character but the last digits, in which mathematical libraries and processors differ."""
    generated = runpy.run_path(str(SCRIPTS / "generate_description.py"))["generate"]()
    assert generated.keys() == {URDF, SRDF, MJCF, SDF, EXTENDED_URDF}
    for name, fresh in generated.items():
        kept = shipped(name)
        assert NUMBER.sub("#", fresh) == NUMBER.sub("#", kept), name
        found, expected = ([float(number) for number in NUMBER.findall(text)] for text in (fresh, kept))
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13, err_msg=name)


def test_meshes_are_fresh_closed_and_small() -> None:
    fresh = runpy.run_path(str(SCRIPTS / "generate_meshes.py"))["generate"]()
    kept = {f"{MESHES}/{path.name}": path for path in (description_directory() / MESHES).iterdir()}
    assert fresh.keys() == kept.keys()
    for name, path in kept.items():
        text = path.read_text(encoding="utf-8")
        assert NUMBER.sub("#", fresh[name]) == NUMBER.sub("#", text)
        expected = [float(number) for number in NUMBER.findall(text)]
        # Coordinates are rounded to 1e-5, which another mathematical library may do the other way.
        np.testing.assert_allclose([float(number) for number in NUMBER.findall(fresh[name])], expected, atol=1.1e-3)
        mesh = trimesh.Trimesh(*read_obj(path))
        assert mesh.is_watertight, name
        assert mesh.is_winding_consistent, name
        loaded = trimesh.load(path, process=False, maintain_order=True)
        assert 0.0 < mesh.volume == pytest.approx(loaded.volume), name
    assert sum(path.stat().st_size for path in kept.values()) < 400_000


def expanded(folder: Path, argument: str) -> str:
    """The sources, by xacro's own command and from another folder: what they name, they find beside themselves."""
    command = [str(Path(sysconfig.get_path("scripts")) / "xacro"), str(description_file(ENTRY)), argument]
    answer = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    assert answer.stderr == ""
    return answer.stdout


def same(text: str) -> str:
    return ElementTree.canonicalize(text, strip_text=True)


def test_the_xacro_command_gives_the_same_tree(tmp_path: Path) -> None:
    other, file = spm.Manipulator(1.5, 0.25, 0.5), tmp_path / "geometry.yaml"
    file.write_text(yaml.safe_dump(other.as_data()), encoding="utf-8")
    assert same(expanded(tmp_path, "prefix:=left_")) == same(urdf_text(prefix="left_", meshes=MESHES))
    assert same(expanded(tmp_path, f"geometry:={file}")) == same(urdf_text(other, meshes=MESHES))


def test_written_files_contain_no_local_path() -> None:
    for text in (urdf_text(meshes=MESHES), *map(shipped, (URDF, SRDF, MJCF, SDF, EXTENDED_URDF))):
        assert str(description_directory()) not in text
        assert str(Path.home()) not in text


def test_prefix_is_on_every_name() -> None:
    bare, prefixed = urdf_text(), urdf_text(prefix="left_")
    named = re.compile(r'<(link|joint|transmission|actuator|material|parent|child)\b[^>]*?(?:name|link)="([^"]*)"')
    assert [(tag, f"left_{name}") for tag, name in named.findall(bare)] == named.findall(prefixed)
    constraint = re.compile(r'<drake:ball_constraint_body_[AB] name="([^"]*)"')
    assert [f"left_{name}" for name in constraint.findall(bare)] == constraint.findall(prefixed)
    assert prefixed.replace("left_", "") == bare
    srdf = srdf_text({}, prefix="left_")
    assert all(name.startswith("left_") for name in re.findall(r'(?:<(?:passive_)?joint name|link\d)="([^"]*)"', srdf))
    extended = yaml.safe_load(extended_urdf_text(prefix="left_"))
    assert extended["name_mot"] == [f"left_{name}" for name in SLIDES]


@pytest.mark.parametrize("prefix", ["1.5", "two words", 'a"b', "$(arg", "left_\n", "true", "NaN", None])
def test_prefixes_that_cannot_begin_a_name(prefix: str) -> None:
    for write in (lambda: urdf_text(prefix=prefix), lambda: srdf_text({}, prefix=prefix)):
        with pytest.raises(DescriptionError, check=with_fields(argument="prefix")):
            write()
    with pytest.raises(ArgumentError):
        read_closures(prefix=prefix)


@pytest.mark.parametrize("prefix", ["r2.d2.", "e1_", "yes"])
def test_prefixes_come_out_as_they_went_in(prefix: str) -> None:
    assert KinematicTree(urdf_text(prefix=prefix)).base == f"{prefix}base"


def test_srdf_of_other_states() -> None:
    state = in_leg_space(PAPER, 1, seed=0).configuration[0]
    text = srdf_text({"mine": state})
    assert list(named_states(text)) == ["home", "mine"]
    other = random_branches(spm.Manipulator(0.7, 0.35, 0.8), "TT", 1, seed=0).configuration[0]
    for wrong in ({"home": state}, {"mine": state, "other": other}):
        with pytest.raises(DescriptionError, check=with_fields(argument="states")):
            srdf_text(wrong)
