"""URDF files made ready for MuJoCo: packages found, every mesh under a name of its own, nothing fused away."""

import math
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco

from regrasp.errors import InputError


@dataclass(frozen=True)
class Urdf:
    """A URDF file as a spec, parsed but not compiled.

    files: where the mesh files are that the spec names, None for one that was not found; uris: what the URDF calls them;
    speeds: joint → its speed limit, rad/s or m/s, where the file gives one; said: what was put right, each in a sentence.
    """

    spec: mujoco.MjSpec
    files: Mapping[str, Path | None]
    uris: Mapping[str, str]
    speeds: Mapping[str, float]
    said: tuple[str, ...]


def read(path: Path, packages: Mapping[str, str]) -> Urdf:
    """The URDF file at `path`; `packages` are folders of packages by name. Raises InputError where it is none."""
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InputError("model.file", f"is not XML: {error}", "a URDF or MJCF file") from None
    if any("ros.org/wiki/xacro" in element.tag for element in root.iter()):
        raise InputError("model.file", "has xacro macros", f"first: xacro {path.name} > robot.urdf")
    compiler = root.find("mujoco/compiler")
    folders = [path.parent, path.parent / (compiler.get("meshdir", "") if compiler is not None else "")]
    for extension in root.findall("mujoco"):
        root.remove(extension)
    # Fusing would drop the bodies that agents are named by; stripped paths would hide what was not found.
    settings = {"fusestatic": "false", "discardvisual": "false", "strippath": "false"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", settings)
    files: dict[str, Path | None] = {}
    names: dict[str, str] = {}
    for mesh in root.iter("mesh"):
        uri = mesh.get("filename", "")
        # MuJoCo takes a mesh file for another one of the same stem: each is given a stem of its own.
        name = names.setdefault(uri, f"{len(names)}-{uri.rsplit('/', 1)[-1]}")
        files[name] = locate(uri, folders, packages)
        mesh.set("filename", name)
    joints = root.findall("joint")
    speeds = {joint.get("name", ""): _number(joint.find("limit"), "velocity") for joint in joints}
    said = _weigh(root.findall("link"), {child.get("link", "") for joint in joints for child in joint.findall("child")})
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise InputError("model.file", f"MuJoCo cannot read it: {' '.join(str(error).split())}") from None
    uris = {name: uri for uri, name in names.items()}
    return Urdf(spec, files, uris, {name: speed for name, speed in speeds.items() if speed > 0.0}, tuple(said))


def locate(uri: str, folders: list[Path], packages: Mapping[str, str]) -> Path | None:
    """The file a URDF calls `uri`, None if there is none.

    package://NAME/… (and model://, Gazebo's) is looked for in `packages`, then in every folder above the first of
    `folders` that is called NAME or holds one that is, then along ROS_PACKAGE_PATH; a plain path counts from `folders`.
    """
    scheme, _, rest = uri.rpartition("://")
    if scheme not in ("package", "model"):  # or a plain path, or file:///…, which is absolute
        places = [folder / rest for folder in folders]
    else:
        package, _, rest = rest.partition("/")
        above = [folders[0].resolve(), *folders[0].resolve().parents]
        along = [Path(entry) for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if entry]
        homes = [Path(packages[package])] if package in packages else []
        for folder in above + along:
            homes += [folder] if folder.name == package else []
            homes += [folder / package]
        places = [home / rest for home in homes]
    return next((place for place in places if place.is_file()), None)


def _weigh(links: list[ElementTree.Element], carried: set[str]) -> list[str]:
    """Fills what is missing of the links' masses and inertias with zeros, which `inertia.repair` looks after.

    Tells which of the links that a joint carries have none at all: MuJoCo takes their geometry for water.
    """
    said = []
    for link in links:
        inertial = link.find("inertial")
        if inertial is None:
            if link.get("name") in carried and link.find("collision") is not None:
                said.append(f"link {link.get('name')!r} has no mass: that of its collision geometry at 1000 kg/m³")
            continue
        for tag, keys in (("mass", ("value",)), ("inertia", ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))):
            element = inertial.find(tag)
            element = ElementTree.SubElement(inertial, tag) if element is None else element
            for key in keys:
                element.set(key, repr(_number(element, key)))
    return said


def _number(element: ElementTree.Element | None, key: str) -> float:
    """A finite number among an element's attributes; 0 where there is none."""
    try:
        number = float(element.get(key, "0")) if element is not None else 0.0
    except ValueError:
        return 0.0
    return number if math.isfinite(number) else 0.0
