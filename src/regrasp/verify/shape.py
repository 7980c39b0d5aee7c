"""A mesh object's surface and convex parts, as the plan carries them, against the mesh it carries."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from regrasp.plan import Plan
from regrasp.scene.triangles import Triangles
from regrasp.scene.world import World
from regrasp.verify.contacts import TOUCH, Contacts, touching
from regrasp.verify.findings import Finding, worst
from regrasp.verify.motion import Motion

Array = NDArray[np.float64]

CREASE = 5e-4
"""How far the surface may stand out of the mesh, m: it rounds off creases, as far as no tip gets."""
COVER = 1e-3
"""How far the parts may leave the surface uncovered, m."""


def shape_findings(plan: Plan, world: World, motion: Motion, contacts: Contacts) -> list[Finding]:
    """The surface lies within the mesh, of which it is the opening, and the parts that collide cover it.

    It may stand out of the mesh where no contact is: in creases.
    """
    matter = world.matter
    if matter.skin is None or matter.mesh is None:
        return []
    vertices = matter.skin.vertices
    triangles = Triangles(matter.mesh.vertices, matter.mesh.faces, 0.01 * float(np.ptp(vertices)))
    out = _outside(triangles, vertices, matter.skin.normals)
    at = np.broadcast_to(touching(plan)[:, None], contacts.gap.shape)
    contact = np.zeros(contacts.gap.shape)
    contact[at] = _outside(triangles, contacts.p_O[at], contacts.n_O[at])
    bare = np.full(len(vertices), np.inf)
    for part in matter.parts:
        planes = ConvexHull(part.vertices + part.p_OP).equations
        bare = np.minimum(bare, np.max(vertices @ planes[:, :3].T + planes[:, 3], axis=1) - part.size[3])
    return [
        Finding(
            "surface and mesh", "how far the object's surface stands out of its mesh", float(out.max()), CREASE, "m"
        ),
        worst("contact and mesh", "how far a measured contact point stands out of the object's mesh", contact, TOUCH, "m",
              "jsx", motion.time, plan.agent_names, at),
        Finding(
            "parts and surface",
            "how far the object's convex parts leave its surface bare",
            float(bare.max()),
            COVER,
            "m",
        ),
    ]  # fmt: skip


def _outside(mesh: Triangles, points: Array, normals: Array) -> Array:
    """How far points (N, 3) of a surface with the outward normals (N, 3) are outside of the mesh, m; 0 inside."""
    away, foot = mesh.nearest(points)
    return np.where(np.sum((points - foot) * normals, axis=1) > 0.0, away, 0.0)
