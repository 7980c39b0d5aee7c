"""What the tests of physics add to the handmade plans: hinges heavy enough for drives, one arm with any drives."""

import dataclasses
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from regrasp.plan import Plan
from regrasp.scene.load import validate
from regrasp.scene.world import World, build


def armed(plan: Plan) -> Plan:
    """The plan with 1e-3 kg m² added to each hinge of a free-flying tip, which alone is too light to be driven at 500 Hz."""
    root = ElementTree.fromstring(plan.xml)
    for joint in root.iter("joint"):
        if "hinge" in joint.get("name", ""):
            joint.set("armature", "0.001")
    return dataclasses.replace(plan, xml=ElementTree.tostring(root, encoding="unicode"))


def limp(plan: Plan) -> Plan:
    """The plan with its forces left out."""
    return dataclasses.replace(plan, force_W=np.zeros_like(plan.force_W))


def arm(directory: Path, actuators: str = "", joint: str = "", body: str = "", **scene: object) -> World:
    """A finger of two hinges and a slide with the given actuators; the object far away unless the scene says."""
    path = directory / "arm.xml"
    path.write_text(f"""<mujoco><worldbody>
      <body name="a" pos="0 0 0.4" {body}> <joint name="j1" axis="0 1 0" armature="0.01" {joint}/>
        <geom name="link" type="capsule" fromto="0 0 0 0.2 0 0" size="0.01" mass="0.4"/>
        <body name="b" pos="0.2 0 0">
          <joint name="j2" axis="0 1 0" damping="0.02" armature="0.01"/> <joint name="j3" type="slide" axis="1 0 0"/>
          <geom name="tip" pos="0.15 0 0" size="0.01" mass="0.2"/>
        </body>
      </body>
    </worldbody><actuator>{actuators}</actuator></mujoco>""")
    start = {"pose": {"position": [1, 0, 0.03]}}
    return build(validate({
        "name": "arm", "model": {"file": str(path)}, "object": {"shape": "sphere", "size": [0.03], "mass": 0.1},
        "agents": [{"name": "arm", "tip": "tip"}], "start": start, "goal": start,
    } | scene))  # fmt: skip
