"""check: a plan in, a certificate out. docs/certificate.md says what every finding measures and why.

The judge shares no mathematics with the planner: it rebuilds the model stored in the plan and measures with MuJoCo's
kinematics and distances, central differences and Clarabel's cone programs.
"""

import numpy as np

from regrasp.errors import InputError
from regrasp.plan import Plan
from regrasp.scene.world import World, from_plan
from regrasp.verify import balance, contacts, form, shape, slip
from regrasp.verify.findings import Certificate, Finding
from regrasp.verify.motion import interpolate


def check(plan: Plan, world: World | None = None) -> Certificate:
    """Judge a plan in the world it carries, or in `world`, which must then be the same.

    A plan whose numbers mean nothing (not finite, illegal codes, another model's names) is refused on these findings
    alone: nothing can be measured. Raises InputError if the stored scene or model cannot be built.
    """
    if world is None:
        world = _rebuild(plan)
    with np.errstate(all="ignore"):  # what overflows becomes no number, and what is no number is refused
        findings = [*form.number_findings(plan), *form.name_findings(plan, world), *form.model_findings(plan, world)]
        if all(finding.passed for finding in findings):
            findings += _measure(plan, world)
    return Certificate(tuple(findings))


def _measure(plan: Plan, world: World) -> list[Finding]:
    motion = interpolate(plan, world)
    touch = contacts.measure(plan, world, motion)
    return [
        *shape.shape_findings(plan, world, motion, touch),
        *form.pose_findings(plan, world),
        *form.grasp_findings(plan, world, touch),
        *form.motion_findings(plan, world, motion),
        *contacts.contact_findings(plan, motion, touch),
        *contacts.support_findings(plan, world, motion),
        *contacts.collision_findings(plan, world, motion),
        *slip.motion_findings(plan, world, motion, touch),
        *slip.support_motion_findings(plan, motion),
        *balance.force_findings(plan, world, motion, touch),
    ]


def _rebuild(plan: Plan) -> World:
    try:
        return from_plan(plan.scene, plan.xml, plan.assets)
    except (ValueError, KeyError) as error:
        raise InputError("plan.xml", f"the stored model cannot be built: {error}", "plan it again") from None
