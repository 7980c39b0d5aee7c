"""check: a plan in, a certificate out. docs/certificate.md says what every finding measures and why.

The judge shares no mathematics with the planner: it rebuilds the model stored in the plan and measures with MuJoCo's
kinematics and distances, central differences and Clarabel's cone programs.
"""

import numpy as np

from regrasp.errors import InputError
from regrasp.plan import Plan
from regrasp.scene.world import World, from_plan
from regrasp.verify import balance, contacts, form, slip
from regrasp.verify.findings import Certificate
from regrasp.verify.motion import interpolate


def check(plan: Plan, world: World | None = None) -> Certificate:
    """Judge a plan in the world it carries, or in `world`, which must then be the same.

    A plan whose numbers mean nothing (not finite, illegal codes, another model's names) is refused on these findings
    alone: nothing can be measured. Raises InputError if the stored scene or model cannot be built.
    """
    if world is None:
        world = _rebuild(plan)
    findings = [*form.number_findings(plan), *form.name_findings(plan, world), *form.model_findings(plan, world)]
    if not all(finding.passed for finding in findings):
        return Certificate(tuple(findings))
    with np.errstate(all="ignore"):
        motion = interpolate(plan, world)
        touch = contacts.measure(plan, world, motion)
        findings += form.pose_findings(plan, world)
        findings += form.grasp_findings(plan, world, touch)
        findings += form.motion_findings(plan, world, motion)
        findings += contacts.contact_findings(plan, motion, touch)
        findings += contacts.support_findings(plan, world, motion)
        findings += contacts.collision_findings(plan, world, motion)
        findings += slip.motion_findings(plan, world, motion, touch)
        findings += slip.support_motion_findings(plan, motion)
        findings += balance.force_findings(plan, world, motion, touch)
    return Certificate(tuple(findings))


def _rebuild(plan: Plan) -> World:
    try:
        return from_plan(plan.scene, plan.xml, plan.assets)
    except (ValueError, KeyError) as error:
        raise InputError("plan.xml", f"the stored model cannot be built: {error}", "plan it again") from None
