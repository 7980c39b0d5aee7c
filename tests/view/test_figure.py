"""Figures: their curves are the plan's numbers, their distances MuJoCo's, and they look the same everywhere."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from matplotlib.colors import to_hex

from regrasp.plan import RELOCATE
from regrasp.scene.world import from_plan
from regrasp.view import strip
from regrasp.view.clearances import KINDS, clearances
from regrasp.view.figure import FAR, PANELS, figure, save
from regrasp.view.frames import Instant, put
from regrasp.view.viewpoint import object_radius


def curves(axes) -> dict[str, np.ndarray]:
    """Label → values of every named curve."""
    return {line.get_label(): line.get_ydata() for line in axes.lines if not line.get_label().startswith("_")}


def panels(plan, *what):
    return figure(plan, what).axes


def test_forces_and_joints_are_the_plan_s(home_plan):
    plan = home_plan("fig3-puma3")
    forces, *joints = panels(plan, "forces", "joints")
    size = np.linalg.norm(plan.force_W, axis=-1)
    assert list(curves(forces)) == list(plan.agent_names)
    for i, name in enumerate(plan.agent_names):
        assert np.array_equal(curves(forces)[name], size[:, :, i].ravel())
    drawn = np.concatenate([np.array(list(curves(axes).values())) for axes in joints])
    assert np.array_equal(drawn, plan.joints.reshape(-1, plan.joints.shape[2]).T)


def test_the_force_of_all_supports_is_their_sum(home_plan):
    plan = home_plan("fig2-planar")
    force = np.zeros_like(plan.support_force_W)
    force[..., 2] = 1.5
    pushed = replace(plan, support_force_W=force, support_mode=np.ones_like(plan.support_mode))
    shown = curves(panels(pushed, "forces")[0])["all supports"]
    assert np.allclose(shown, 1.5 * len(plan.support_names))


def test_the_energy_falls_to_the_least_of_each_arc(home_plan):
    plan = replace(
        home_plan("fig3-puma3"), energy=np.array([9.0, 4.0, 6.0, 5.0, 7.0]), energy_segment=np.array([0, 0, 0, 1, 1])
    )
    lines = [line.get_ydata().tolist() for line in panels(plan, "energy")[0].lines]
    assert lines == [[9.0, 4.0, 6.0], [9.0, 4.0, 4.0], [5.0, 7.0], [5.0, 5.0]]


def test_cells_of_V_last_as_long_as_their_intervals_and_have_their_motion_s_colour(home_plan):
    plan = home_plan("fig3-puma3")
    bars = panels(plan, "V")[0].collections[0]
    for j, (path, colour) in enumerate(zip(bars.get_paths(), bars.get_facecolors(), strict=True)):
        assert np.allclose(np.unique(path.vertices[:, 0]), plan.time[j, [0, -1]] - plan.time[0, 0])
        assert to_hex(colour) == strip.fill(int(plan.V[j, 0])).lower()


@pytest.mark.parametrize("scene", ["fig3-puma3", "peg-hole"])
def test_clearances_are_the_least_distances_of_all_pairs_of_their_kind(home_plan, scene):
    plan = home_plan(scene)
    world = from_plan(plan.scene, plan.xml, plan.assets)
    far = FAR * object_radius(world)
    found = clearances(plan, world, far)
    owner = {g: "agent" for agent in world.agents for g in agent.geoms}
    owner |= dict.fromkeys(world.object_geoms, "object")
    data = mujoco.MjData(world.model)
    for j, m in ((0, 0), (2, 2), (4, 3)):
        put(world, plan, Instant(j, m), data)
        pairs = [tuple(pair) for pair in world.collision_pairs]
        for agent, code in zip(world.agents, plan.V[j], strict=True):
            if code >= RELOCATE:
                pairs += [(tip, g) for tip in agent.tip_geoms for g in world.object_geoms]
        least = {}
        for a, b in pairs:
            kind = "–".join(sorted(owner.get(g, "surroundings") for g in (a, b)))
            distance = mujoco.mj_geomDistance(world.model, data, a, b, far, None)
            least[kind] = min(least.get(kind, far), distance)
        assert set(least) == set(found) <= set(KINDS)
        for kind, distance in least.items():
            assert found[kind][j, m] == pytest.approx(distance, abs=1e-12)


def test_figures_are_whole_carry_their_fonts_and_are_the_same_every_time(home_plan, tmp_path):
    plan = home_plan("fig3-puma3")
    for suffix in (".pdf", ".svg", ".png"):
        for name in ("a", "b"):
            save(figure(plan, ("V", "forces")), tmp_path / f"{name}{suffix}")
        content = (tmp_path / f"a{suffix}").read_bytes()
        assert content == (tmp_path / f"b{suffix}").read_bytes()
        if suffix == ".pdf":
            assert b"/FontFile2" in content
        if suffix == ".svg":
            assert b"<text" not in content
            assert b"http" not in content.split(b"<metadata>")[1].split(b"</metadata>")[1]
    whole = figure(plan)
    assert len(whole.axes) == len(PANELS) - 1 + len(plan.agent_names)
    whole.draw_without_rendering()
    # The same time is at the same place in all panels.
    timed = [axes for axes in whole.axes if axes.get_title(loc="left")[:6] != "energy"]
    assert np.ptp([axes.get_window_extent().x0 for axes in timed]) < 0.5
    assert np.ptp([axes.get_window_extent().x1 for axes in timed]) < 0.5
