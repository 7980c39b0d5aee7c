"""A model as MJCF text that stands for itself: every digit kept, every file it needs beside it."""

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
from numpy.typing import ArrayLike


def text(spec: mujoco.MjSpec) -> str:
    """The model as XML.

    MuJoCo writes six digits; the poses, sizes and ranges are written again here with all of them, so that kinematics
    agrees with the tables it came from to round-off.
    """
    for kind, elements in (("body", spec.bodies), ("joint", spec.joints), ("geom", spec.geoms)):
        for i, element in enumerate(elements):
            element.name = element.name or f"{kind}{i}"
    model = spec.compile()
    root = ElementTree.fromstring(spec.to_xml())
    framed = {child for frame in root.iter("frame") if {"pos", "quat"} & set(frame.attrib) for child in frame.iter()}
    for element in root.iter():
        if element in framed:
            continue  # the compiled pose holds that of the frame already
        if element.tag == "body":
            _body(element, model)
        elif element.tag in ("joint", "freejoint") and element.get("name"):
            _joint(element, model)
        elif element.tag == "mesh" and element.get("vertex"):
            _write(element, "vertex", spec.mesh(element.get("name")).uservert)
        elif element.tag == "geom" and element.get("name"):
            _geom(element, model)
        elif element.tag == "text" and element.text:  # written as CDATA, which this XML library does not keep
            element.set("data", element.text)
            element.text = None
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _write(element: ElementTree.Element, key: str, values: ArrayLike) -> None:
    element.set(key, " ".join(repr(float(x)) for x in np.atleast_1d(values)))


def _body(element: ElementTree.Element, model: mujoco.MjModel) -> None:
    body = model.body(element.get("name"))
    for key in ("axisangle", "euler", "xyaxes", "zaxis"):
        element.attrib.pop(key, None)
    _write(element, "pos", body.pos)
    _write(element, "quat", body.quat)
    inertial = element.find("inertial")
    if inertial is not None:
        inertial.attrib.pop("fullinertia", None)
        for key, values in (
            ("pos", body.ipos),
            ("quat", body.iquat),
            ("mass", body.mass),
            ("diaginertia", body.inertia),
        ):
            _write(inertial, key, values)


def _joint(element: ElementTree.Element, model: mujoco.MjModel) -> None:
    joint = model.joint(element.get("name"))
    if mujoco.mjtJoint(int(joint.type[0])) not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        return
    _write(element, "pos", joint.pos)
    _write(element, "axis", joint.axis)
    dof = model.jnt_dofadr[joint.id]
    _write(element, "armature", model.dof_armature[dof])
    if element.get("range"):
        _write(element, "range", joint.range)
    if element.get("actuatorfrcrange"):
        _write(element, "actuatorfrcrange", model.jnt_actfrcrange[joint.id])


def _geom(element: ElementTree.Element, model: mujoco.MjModel) -> None:
    geom = model.geom(element.get("name"))
    # The compiler moves a mesh into its own principal frame; its pose in the file is not the compiled one.
    if geom.dataid[0] >= 0:
        return
    for key in ("axisangle", "euler", "xyaxes", "zaxis", "fromto"):
        element.attrib.pop(key, None)
    _write(element, "pos", geom.pos)
    _write(element, "quat", geom.quat)
    _write(element, "size", geom.size)
