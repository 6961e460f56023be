"""Model files that attack: nothing outside of the spec's folder and the shipped scenes is opened unless asked.

The oracle is the kernel, which tells of every file that anyone opens (`opened`), and the model, in which the content of
the outside file would show. One case: `pytest tests/test_inputs_models.py -k CASE`.
"""

from __future__ import annotations

import os
import re
import struct
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from opened import LINUX, opened

from wbc import files
from wbc.build import build
from wbc.cli import main
from wbc.errors import ModelError, SpecError
from wbc.model import compile_model, compose
from wbc.resources import shipped_folder
from wbc.robot import Robot
from wbc.spec import load

MASS = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
ARM = """<mujoco>{top}<worldbody>
<body name="link"><joint name="turn" axis="0 0 1" range="-2 2" limited="true"/>{body}<site name="tip" pos="1 0 0"/>
<site name="flange" pos="1 0 0"/></body></worldbody>
<actuator><motor joint="turn" ctrlrange="-9 9" ctrllimited="true"/></actuator>{more}</mujoco>"""
PLAIN = ARM.format(top="", body=MASS, more="")
SECRET = '<mujoco><worldbody><body name="secret">' + MASS + '<site name="seen"/></body></worldbody></mujoco>'
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
URDF = (
    f'<robot name="r"><link name="a">{INERTIAL}{{link}}</link><link name="b">{INERTIAL}</link><joint name="j" '
    'type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="5" '
    'velocity="1"/></joint>{more}</robot>'
)


def stl() -> bytes:
    """A tetrahedron."""
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [[corners[i] for i in face] for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *sum(face, ()), 0) for face in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + body


def meshed(file: str, compiler: str = "") -> str:
    asset = f'<asset><mesh name="m" file="{file}"/></asset>'
    return ARM.format(top=compiler, body=MASS + '<geom type="mesh" mesh="m"/>', more=asset)


def topped(top: str) -> str:
    return ARM.format(top=top, body=MASS, more="")


ATTACH = '<asset><model name="x" file="{}"/></asset>'
TEXTURE = '<asset><texture name="t" type="{}" {}/><material name="t" texture="t"/></asset>'
ALL_SIDES = " ".join(f'file{side}="../out/secret.png"' for side in ("right", "left", "up", "down", "front", "back"))

# Each reaches for ../out: the files beside the spec; OUT is the folder's absolute path. The main one is arm.xml.
REACHING: dict[str, dict[str, str]] = {
    "include": {"arm.xml": topped('<include file="../out/secret.xml"/>')},
    "include_absolute": {"arm.xml": topped('<include file="OUT/secret.xml"/>')},
    "include_in_an_include": {
        "arm.xml": topped('<include file="sub/a.xml"/>'),
        "sub/a.xml": '<mujoco><include file="../../out/secret.xml"/></mujoco>',
    },
    "include_in_a_body": {"arm.xml": ARM.format(top="", body=MASS + '<include file="../out/secret.xml"/>', more="")},
    "include_by_a_character_reference": {"arm.xml": topped('<include file="&#46;&#x2e;/out/secret.xml"/>')},
    "include_through_a_link": {"arm.xml": topped('<include file="link.xml"/>')},
    "include_through_a_linked_folder": {"arm.xml": topped('<include file="linked/secret.xml"/>')},
    "include_back_through_a_linked_folder": {"arm.xml": topped('<include file="inner/../secret.xml"/>')},
    "attach": {"arm.xml": topped(ATTACH.format("../out/secret.xml"))},
    "attached_includes": {
        "arm.xml": topped(ATTACH.format("sub/b.xml")),
        "sub/b.xml": '<mujoco><include file="../../out/secret.xml"/></mujoco>',
    },
    "mesh": {"arm.xml": meshed("../out/secret.stl")},
    "mesh_absolute": {"arm.xml": meshed("OUT/secret.stl")},
    "mesh_link": {"arm.xml": meshed("link.stl")},
    "meshdir": {"arm.xml": meshed("secret.stl", '<compiler meshdir="../out"/>')},
    "meshdir_absolute": {"arm.xml": meshed("secret.stl", '<compiler meshdir="OUT"/>')},
    "assetdir": {"arm.xml": meshed("secret.stl", '<compiler assetdir="../out"/>')},
    "meshdir_of_an_include": {
        "arm.xml": meshed("secret.stl", '<include file="sub/c.xml"/>'),
        "sub/c.xml": '<mujoco><compiler meshdir="../out"/></mujoco>',
    },
    # MuJoCo only asks whether it is there
    "stripped_path": {"arm.xml": meshed("../out/secret.stl", '<compiler strippath="true"/>')},
    "texture": {"arm.xml": topped(TEXTURE.format("2d", 'file="../out/secret.png"'))},
    "texture_of_six": {"arm.xml": topped(TEXTURE.format("cube", ALL_SIDES))},
    "texturedir": {
        "arm.xml": topped('<compiler texturedir="../out"/>' + TEXTURE.format("2d", 'file="secret.png"')),
    },
    "height_field": {"arm.xml": topped('<asset><hfield name="h" file="../out/secret.png" size="1 1 1 1"/></asset>')},
    "skin": {"arm.xml": topped('<asset><skin name="s" file="../out/secret.skn"/></asset>')},
    "flex": {
        "arm.xml": ARM.format(
            top="",
            body=MASS,
            more='<worldbody><flexcomp name="f" type="gmsh" file="../out/secret.msh" dim="3"/></worldbody>',
        )
    },
    "it_is_a_link": {"arm.xml": "-> ../out/arm.xml"},
    "spec_names_it": {"spec": "../out/arm.xml", "arm.xml": PLAIN},
    "spec_names_it_absolutely": {"spec": "OUT/arm.xml", "arm.xml": PLAIN},
    "spec_names_a_urdf": {"spec": "../out/arm.urdf", "arm.xml": PLAIN},
}
# These are read, and what they name outside is not.
DROPPED: dict[str, dict[str, str]] = {
    "urdf_mesh": {
        "arm.urdf": URDF.format(
            link='<visual><geometry><mesh filename="../out/secret.stl"/></geometry></visual><collision><geometry>'
            '<mesh filename="package://x/../../out/secret.stl"/></geometry></collision>',
            more="",
        )
    },
    "urdf_include": {"arm.urdf": URDF.format(link="", more='<include file="../out/secret.xml"/>')},
    "urdf_include_in_a_link": {"arm.urdf": URDF.format(link='<include file="../out/secret.xml"/>', more="")},
    "urdf_extension": {
        "arm.urdf": URDF.format(
            link="", more='<mujoco><compiler meshdir="../out"/><include file="../out/secret.xml"/></mujoco>'
        )
    },
    "srdf_in_the_folder_above": {"arm.urdf": URDF.format(link="", more="")},
    "srdf_link": {"arm.urdf": URDF.format(link="", more=""), "arm.srdf": "-> ../out/arm.srdf"},
}


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """The folder of the specs; beside it `out`, with the secrets, and `srdf`."""
    inside, out, srdf = (tmp_path / name for name in ("in", "out", "srdf"))
    for folder in (inside, out, srdf, inside / "sub"):
        folder.mkdir()
    (out / "inner").mkdir()
    for file in ("secret.xml", "inner/secret.xml"):
        (out / file).write_text(SECRET)
    (out / "arm.xml").write_text(PLAIN)
    (out / "arm.urdf").write_text(URDF.format(link="", more=""))
    (out / "secret.stl").write_bytes(stl())
    for name in ("secret.png", "secret.skn", "secret.msh"):
        (out / name).write_bytes(b"secret")
    for file in (out / "arm.srdf", srdf / "arm.srdf"):
        file.write_text(
            '<robot name="r"><group_state name="secret"><joint name="j" value="0.5"/></group_state></robot>'
        )
    (inside / "link.xml").symlink_to(out / "secret.xml")
    (inside / "link.stl").symlink_to("../out/secret.stl")
    (inside / "linked").symlink_to(out)
    (inside / "inner").symlink_to(out / "inner")  # inner/.. is `in` to who reads the name, and `out` to the kernel
    return inside


def spec(place: Path, written: dict[str, str], kind: str = "robot") -> Path:
    """The spec that names the model as its robot, its tool or its scene."""
    out = place.parent / "out"
    model = next(name for name in written if name.startswith("arm."))
    for name, text in written.items():
        if text.startswith("-> "):
            (place / name).symlink_to(text[3:])
        elif name != "spec":
            (place / name).write_text(text.replace("OUT", str(out)))
    lines = {"robot": "planar3r", kind: written.get("spec", model).replace("OUT", str(out))}
    file = place / "task.yaml"
    file.write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))
    return file


def outside(place: Path) -> tuple[Path, ...]:
    return tuple(place.parent / name for name in ("out", "out/inner", "srdf"))


@pytest.mark.row(17)
@pytest.mark.skipif(not LINUX, reason="the kernel tells of opened files on Linux")
@pytest.mark.parametrize("kind", ["robot", "tool", "scene"])
@pytest.mark.parametrize("case", REACHING)
def test_nothing_outside_is_opened(case: str, kind: str, place: Path, tell: Any) -> None:
    file = spec(place, REACHING[case], kind)
    with opened(*outside(place)) as names:
        result = CliRunner().invoke(main, ["check", str(file), "--json"])
    tell("files opened outside", len(names), most=0, why=str(names))
    assert result.exit_code == 2, result.output
    assert re.search(rf"task.yaml:\d:1: {kind}: ", result.stderr)
    assert "outside of the spec's folder" in result.stderr
    assert "--allow-outside" in result.stderr


@pytest.mark.row(17)
@pytest.mark.skipif(not LINUX, reason="the kernel tells of opened files on Linux")
@pytest.mark.parametrize("case", [case for case in REACHING if case != "stripped_path"])
def test_the_same_files_are_opened_when_asked(case: str, place: Path) -> None:
    """The one above could fail: what these cases reach for is there, and MuJoCo takes it."""
    file = spec(place, REACHING[case])
    with opened(*outside(place)) as names:
        CliRunner().invoke(main, ["check", str(file), "--allow-outside", "--json"])
    assert names, "nothing was opened: the case is none"


@pytest.mark.row(17)
@pytest.mark.skipif(not LINUX, reason="the kernel tells of opened files on Linux")
@pytest.mark.parametrize("case", DROPPED)
def test_what_is_left_out_is_not_opened(case: str, place: Path) -> None:
    with opened(*outside(place)) as names:
        built = build(load(spec(place, DROPPED[case])))
    assert names == set()
    assert "secret" not in built.robot.keyframes


def test_it_shows_in_the_model_when_asked(place: Path) -> None:
    file = spec(place, REACHING["include_in_an_include"])
    with pytest.raises(SpecError, match=r"a\.xml:1: '.*secret\.xml' is outside of the spec's folder"):
        build(load(file))
    assert "seen" in build(load(file, allow_outside=True)).robot.frames


def test_a_model_given_by_hand_is_asked_for(place: Path) -> None:
    """`--set robot=FILE` names a file from anywhere, which may draw in what stands beside it, and no more."""
    out = place.parent / "out"
    file = spec(place, {"arm.xml": PLAIN})
    assert build(load(file, [f"robot={out / 'arm.xml'}"])).robot.joints == ("turn",)
    (out / "further.xml").write_text(topped('<include file="../srdf/arm.srdf"/>'))
    with pytest.raises(SpecError, match=r"--set robot=.*arm\.srdf' is outside of the spec's folder"):
        build(load(file, [f"robot={out / 'further.xml'}"]))


def test_what_stands_inside_is_read(place: Path) -> None:
    """Folders of the spec's own, links that stay inside, shipped scenes, names that step out and back in."""
    (place / "robots").mkdir()
    (place / "sub" / "m.stl").write_bytes(stl())
    (place / "own.stl").symlink_to("sub/m.stl")
    for name, compiler in (("m.stl", "../sub"), ("../own.stl", "."), ("../in/sub/m.stl", "..")):
        (place / "robots" / "arm.xml").write_text(meshed(name, f'<compiler meshdir="{compiler}"/>'))
        (place / "task.yaml").write_text("robot: robots/arm.xml\nscene: floor\n")
        assert build(load(place / "task.yaml")).robot.mujoco.nmesh == 1
    scene = shipped_folder("scenes") / "floor.xml"
    (place / "arm.xml").write_text(topped(f'<include file="{scene}"/>'))
    (place / "task.yaml").write_text("robot: arm.xml\n")
    assert "floor" in build(load(place / "task.yaml")).robot.frames
    files.judge(shipped_folder("scenes") / "whiteboard.xml", files.real([shipped_folder("scenes")]))


@pytest.mark.row(17)
@pytest.mark.parametrize("name", sorted(path.name for path in shipped_folder("scenes").rglob("*.xml")))
def test_shipped_models_stay_inside(name: str) -> None:
    (path,) = shipped_folder("scenes").rglob(name)
    files.judge(path, files.real([shipped_folder("scenes")]))


# --- Files that are wrong in themselves -------------------------------------------------------------------------------

LAUGHS = (
    "<!DOCTYPE mujoco [<!ENTITY a 'ha'>"
    + "".join(f"<!ENTITY {b} '{f'&{a};' * 10}'>" for a, b in zip("abcdefgh", "bcdefghi", strict=True))
    + "]>"
)
EXTERNAL = "<!DOCTYPE mujoco [<!ENTITY e SYSTEM '../out/secret.xml'>]>"
PLUGIN = '<extension><plugin plugin="mujoco.sensor.touch_grid"><instance name="p"/></plugin></extension>'

WRONG: dict[str, tuple[str | bytes, str]] = {
    "entity_bomb": (LAUGHS + topped("<custom><text name='t' data='&i;'/></custom>"), "document types and entities"),
    "external_entity": (EXTERNAL + topped("&e;"), "document types and entities"),
    "external_document_type": ("<!DOCTYPE m SYSTEM '../out/secret.xml'>" + PLAIN, "document types and entities"),
    "utf_16": (PLAIN.encode("utf-16"), "zero byte"),
    "latin_1": (b'<?xml version="1.0" encoding="latin-1"?>' + PLAIN.encode(), "encoding 'latin-1'; expected UTF-8"),
    "not_utf_8": (topped("<!-- \xe4 -->").encode("latin-1"), "not readable as XML"),
    "depth_20_000": (topped("<a>" * 20_000), "nested more than 200"),
    "depth_20_000_bodies": (topped("<worldbody>" + "<body>" * 20_000), "nested more than 200"),
    "huge_xml": (PLAIN + " " * files.MAX_XML, "larger than 16 MiB"),
    "line_break_in_a_name": (topped('<include file="a&#10;b.xml"/>'), "without spaces"),
    "backslash_in_a_name": (meshed("..\\out\\secret.stl"), "without spaces and backslashes"),
    "billion_copies": (
        topped('<worldbody><replicate count="1000"><replicate count="1000000"><geom size="1"/></replicate></replicate>')
        + "</worldbody>",
        "makes 1e+09 copies",
    ),
    "huge_height_field": (
        topped('<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'),
        "has 1e+10 cells",
    ),
    "huge_texture": (
        topped('<asset><texture name="t" type="2d" builtin="flat" width="99999" height="99999"/></asset>'),
        "cells",
    ),
    "urdf_as_mjcf": (URDF.format(link="", more=""), "begins with <robot>; expected <mujoco>"),
    "plugin": (topped(PLUGIN), "plugins run code of their own"),
    "missing_mesh": (meshed("no.stl"), "<mesh> names 'no.stl', and there is no such file"),
    "missing_texture": (topped(TEXTURE.format("2d", 'file="no.png"')), "<texture> names 'no.png', and there is no"),
    "mesh_is_a_folder": (meshed("sub"), "there is no such file"),
    "mesh_of_no_triangles": (meshed("text.stl"), "MuJoCo refuses"),
    "mesh_that_lies_about_its_size": (meshed("lying.stl"), "MuJoCo refuses"),
    "mesh_cut_off": (meshed("cut.stl"), "MuJoCo refuses"),
    "mesh_of_nan": (meshed("nan.stl"), "MuJoCo refuses"),
    "mesh_is_huge": (meshed("huge.stl"), "larger than 256 MiB"),
    "mesh_is_a_pipe": (meshed("pipe.stl"), "is not a regular file"),
    "mesh_of_unknown_kind": (meshed("text.fbx"), "MuJoCo"),
    "NaN_mass": (PLAIN.replace('mass="1"', 'mass="nan"'), ""),
    "infinite_mass": (PLAIN.replace('mass="1"', 'mass="1e400"'), ""),
    "zero_mass": (PLAIN.replace('mass="1"', 'mass="0"').replace("1 1 1", "0 0 0"), ""),
    "NaN_range": (PLAIN.replace('range="-2 2"', 'range="nan 2"'), ""),
    "range_upside_down": (PLAIN.replace('range="-2 2"', 'range="2 -2"'), ""),
    "NaN_axis": (PLAIN.replace('axis="0 0 1"', 'axis="nan 0 1"'), ""),
    "NaN_option": (topped('<option timestep="nan"/>'), ""),
    "NaN_gravity": (topped('<option gravity="0 0 nan"/>'), ""),
    "NaN_site": (PLAIN.replace('pos="1 0 0"/>\n', 'pos="nan 0 0"/>\n'), ""),
    "infinite_gravity": (topped('<option gravity="0 0 -1e400"/>'), ""),
    "memory": (topped('<size memory="900000T"/>'), ""),
    "two_joints_of_a_name": (PLAIN.replace(MASS, '<joint name="turn" axis="1 0 0"/>' + MASS), "repeated name"),
    "no_joint": ("<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>", "it has no joint"),
    "nothing": ("<mujoco/>", "it has no joint"),
    "text": ("robot: panda", "not readable as XML"),
}
WRONG_URDF: dict[str, str] = {
    "mjcf_as_urdf": PLAIN,
    "mjcf_that_includes": topped('<include file="../out/secret.xml"/>'),
    "entity_bomb": LAUGHS + URDF.format(link="", more=""),
    "two_links_of_a_name": URDF.format(link="", more=f'<link name="b">{INERTIAL}</link>'),
    "two_joints_of_a_name": URDF.format(
        link="",
        more=f'<link name="c">{INERTIAL}</link><joint name="j" type="continuous"><parent link="a"/><child link="c"/>'
        "</joint>",
    ),
    "two_roots": URDF.format(link="", more=f'<link name="c">{INERTIAL}</link>'),
    "loop": URDF.format(link="", more='<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>'),
    "no_such_link": URDF.format(link="", more="").replace('child link="b"', 'child link="c"'),
    "no_such_type": URDF.format(link="", more="").replace("revolute", "twisted"),
    "no_parent": URDF.format(link="", more="").replace('<parent link="a"/>', ""),
    "NaN_mass": URDF.format(link="", more="").replace('mass value="1"', 'mass value="nan"'),
    "text_mass": URDF.format(link="", more="").replace('mass value="1"', 'mass value="one"'),
    "text_inertia": URDF.format(link="", more="").replace('ixx="1"', 'ixx="one"'),
    "infinite_inertia": URDF.format(link="", more="").replace('ixx="1"', 'ixx="1e400"'),
    "negative_mass": URDF.format(link="", more="").replace('mass value="1"', 'mass value="-1"'),
    "no_inertia": URDF.format(link="", more="").replace(INERTIAL, ""),
    "text_velocity": URDF.format(link="", more="").replace('velocity="1"', 'velocity="fast"'),
    "NaN_velocity": URDF.format(link="", more="").replace('velocity="1"', 'velocity="nan"'),
    "NaN_effort": URDF.format(link="", more="").replace('effort="5"', 'effort="nan"'),
    "NaN_axis": URDF.format(link="", more="").replace('xyz="0 0 1"', 'xyz="nan 0 1"'),
    "zero_axis": URDF.format(link="", more="").replace('xyz="0 0 1"', 'xyz="0 0 0"'),
    "no_joint": f'<robot name="r"><link name="a">{INERTIAL}</link></robot>',
    "nothing": '<robot name="r"/>',
    "text": "robot",
    "joint_without_a_name": URDF.format(link="", more="").replace('joint name="j"', "joint"),
    "link_without_a_name": URDF.format(link="", more="").replace('link name="a"', "link"),
}
REMEDY = re.compile("expected|did you mean")


def refused(place: Path, model: str) -> str:
    """Stderr of `check`, which refuses the robot with one located message, and without a traceback."""
    (place / "task.yaml").write_text(f"robot: {model}\n")
    begun = time.perf_counter()
    result = CliRunner().invoke(main, ["check", str(place / "task.yaml"), "--json"])
    print(f"{model}: {time.perf_counter() - begun:.2f} s: {result.stderr.strip()}")
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith(f"{place / 'task.yaml'}:1:1: robot: ")
    assert REMEDY.search(line)
    assert line.isprintable()
    assert len(line) < 700
    return line


@pytest.mark.row(17)
@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_mjcf_is_told(case: str, place: Path) -> None:
    text, message = WRONG[case]
    (place / "arm.xml").write_bytes(text if isinstance(text, bytes) else text.encode())
    (place / "text.stl").write_text("no triangles")
    (place / "text.fbx").write_text("no triangles")
    (place / "lying.stl").write_bytes(bytes(80) + struct.pack("<I", 2**31) + bytes(50))
    (place / "cut.stl").write_bytes(stl()[:-20])
    (place / "nan.stl").write_bytes(stl()[:96] + struct.pack("<9f", *[float("nan")] * 9) + stl()[132:])
    with (place / "huge.stl").open("wb") as stream:
        stream.truncate(files.MAX_FILE + 1)  # sparse: it takes no room
    os.mkfifo(place / "pipe.stl")
    assert message in refused(place, "arm.xml")


@pytest.mark.row(17)
@pytest.mark.parametrize("case", WRONG_URDF)
def test_a_wrong_urdf_is_told(case: str, place: Path) -> None:
    (place / "arm.urdf").write_text(WRONG_URDF[case])
    refused(place, "arm.urdf")


@pytest.mark.row(17)
def test_a_model_without_limits_is_noted(place: Path) -> None:
    text = PLAIN.replace(' range="-2 2" limited="true"', "").replace(' ctrlrange="-9 9" ctrllimited="true"', "")
    (place / "arm.xml").write_text(text)
    (place / "task.yaml").write_text("robot: arm.xml\nlimits: {torque: model, position: model, velocity: model}\n")
    notes = " ".join(build(load(place / "task.yaml")).notes)
    for limit in ("torque", "position", "velocity"):
        assert f"limits.{limit}: the model states none for turn" in notes


@pytest.mark.row(17)
def test_what_may_not_be_opened_is_told(place: Path) -> None:
    for name in (".", "pipe.xml"):
        if name == "pipe.xml":
            os.mkfifo(place / name)
        refused(place, name)
    (place / "arm.xml").write_text(PLAIN)
    (place / "arm.xml").chmod(0)
    if not os.access(place / "arm.xml", os.R_OK):  # the superuser may read it
        assert "Permission denied" in refused(place, "arm.xml")


def test_a_robot_loaded_by_a_program_may_be_anywhere(place: Path) -> None:
    (place / "sub" / "arm.xml").write_text(topped('<include file="../../out/secret.xml"/>'))
    assert "seen" in Robot.load(str(place / "sub" / "arm.xml")).frames
    folders = files.real([place])
    with pytest.raises(ModelError, match="outside of the spec's folder"):
        Robot.load(str(place / "sub" / "arm.xml"), folders=folders)
    assert compile_model(compose(place / "sub" / "arm.xml").spec).nbody == 3
