"""The page in a real browser: what is to be seen is where the plan has it, and it does what clicks and keys ask for."""

import json
from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from regrasp.plan import Plan
from regrasp.scene.world import from_plan
from regrasp.verify.findings import Certificate, Finding
from regrasp.view.frames import Instant, put
from regrasp.view.ink import AGENT_FORCE, AGENTS, rgb
from regrasp.view.page import page
from regrasp.view.server import Server
from regrasp.view.story import judged, pack, tell
from tests.browser import Browser

WRONG = Finding("balance", "residual of the wrench", 0.02, 1e-6, "", 3, 3.4, "finger2")
FINE = Finding("contact gap", "distance", 1e-6, 1e-4, "m")


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[Browser]:
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def plan(home_plan) -> Plan:
    return home_plan("fig3-puma3")


@pytest.fixture(scope="module")
def file(browser, plan, tmp_path_factory) -> Browser:
    """The browser at a file of a plan with one violation."""
    path = tmp_path_factory.mktemp("page") / "plan.html"
    path.write_text(page(pack(judged(tell(plan), Certificate((FINE, WRONG))))), "utf-8")
    browser.requests.clear()
    browser.open(path.as_uri())
    browser.run("regrasp.patience = Infinity")  # rough pictures do
    return browser


def now(browser: Browser) -> float:
    return float(browser.run("regrasp.time"))


def seek(browser: Browser, time: float) -> None:
    browser.run(f"regrasp.play(false), regrasp.seek({time})")


def layers(browser: Browser, *names: str) -> None:
    """Switch these on and all others off, as a user does."""
    for name in browser.run("Object.keys(regrasp.layers)"):
        if browser.run(f"regrasp.layers.{name}") != (name in names):
            browser.run(f"document.querySelector('#layer-{name} input').click()")


def place(browser: Browser, point: np.ndarray) -> np.ndarray:
    return np.array(browser.run(f"regrasp.place({json.dumps([float(x) for x in point])})"))


def looks_like(picture: np.ndarray, colour: str) -> np.ndarray:
    """Where a picture has the hue of a colour, lit or shaded: (height, width)."""
    direction = rgb(colour) - rgb(colour).mean()
    grey = picture.mean(axis=2, keepdims=True)
    strength = np.linalg.norm(picture - grey, axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        same = (picture - grey) @ direction / (strength * np.linalg.norm(direction))
    return (strength > 30) & (same > 0.97)


def arrows(browser: Browser) -> np.ndarray:
    """Where the scene shows arrows of agents' forces: (height, width)."""
    found = looks_like(browser.picture(), AGENT_FORCE)
    for part, inside in (("#view", True), ("#legend", False)):
        x, y, wide, high = map(round, browser.box(part))
        here = np.zeros(found.shape, bool)
        here[y : y + high, x : x + wide] = True
        found &= here if inside else ~here
    return found


def test_the_object_and_the_tips_are_where_the_plan_has_them(file, plan):
    world = from_plan(plan.scene, plan.xml, plan.assets)
    data = mujoco.MjData(world.model)
    layers(file)
    for instant in (Instant(0, 0), Instant(4, 3)):
        seek(file, plan.time[instant.interval, instant.sample])
        picture = file.picture()
        put(world, plan, instant, data)
        x, y = place(file, data.xpos[world.object_body]).round().astype(int)
        warm = picture[y - 12 : y + 12, x - 12 : x + 12].reshape(-1, 3)
        assert np.median(warm[:, 0] - warm[:, 2]) > 15  # beige, as nothing else here is
        seen = 0
        for agent, colour in zip(world.agents, AGENTS, strict=False):
            x, y = place(file, data.geom_xpos[agent.tip_geom]).round().astype(int)
            seen += looks_like(picture, colour)[y - 8 : y + 8, x - 8 : x + 8].mean() > 0.5
        assert seen >= len(world.agents) - 1  # one may be behind the object


def test_arrows_stand_at_the_contacts_and_move_with_them(file, plan):
    layers(file, "forces")
    heads = []
    for interval in (0, 4):
        seek(file, plan.time[interval, 0])
        drawn = arrows(file)
        y, x = np.nonzero(drawn)
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, plan.object_quaternion[interval, 0])
        points = plan.object_position[interval, 0] + plan.p_OC_O[interval, 0] @ R.reshape(3, 3).T
        for point in points:
            head = place(file, point)
            assert np.min(np.hypot(x - head[0], y - head[1])) < 5
        heads.append(drawn)
    assert np.sum(heads[0] & ~heads[1]) > 200  # they have moved
    layers(file)
    assert not arrows(file).any()


def test_it_plays_and_space_stops_it(file):
    seek(file, 0.0)
    before = file.picture()
    file.click_on("#play")
    file.until("regrasp.time > 0.3")
    file.press(" ")
    stopped = now(file)
    assert np.sum(np.abs(file.picture() - before).max(axis=2) > 40) > 500
    assert now(file) == stopped
    assert f"{stopped:.2f} s" in file.run("document.querySelector('#clock').textContent")


def test_arrow_keys_step_from_sample_to_sample(file, plan):
    seek(file, 0.0)
    for _ in range(5):
        file.press("ArrowRight")
    times = np.unique(plan.time)
    assert now(file) == pytest.approx(times[5], abs=1e-5)
    file.press("ArrowLeft")
    assert now(file) == pytest.approx(times[4], abs=1e-5)
    file.press("Home")
    assert now(file) == 0.0


def test_a_click_on_the_track_goes_there(file, plan):
    box = file.box("#rail")
    file.click(box[0] + 0.5 * box[2], box[1] + 0.5 * box[3])
    middle = (plan.time[0, 0] + plan.time[-1, -1]) / 2
    assert now(file) == pytest.approx(middle, abs=0.02 * middle)


def test_a_click_on_an_entry_of_v_goes_there_and_tells_of_it(file, plan):
    cells = file.run("document.querySelectorAll('#cells [data-i]').length")
    assert cells == plan.V.size
    file.click_on("#cells [data-j='2'][data-i='0']")
    assert now(file) == pytest.approx(plan.time[2, 0], abs=1e-3)
    file.picture()
    told = file.run("document.querySelector('#told').textContent")
    assert "finger1 goes to another place on the object" in told
    assert file.run("document.querySelector('#where').textContent") == "interval 3 of 5"


def test_violations_are_listed_marked_and_lead_to_their_time(file):
    assert "refused: 1 violation" in file.run("document.querySelector('#verdict').textContent")
    assert "balance" in file.run("document.querySelector('#findings').textContent")
    assert file.run("parseFloat(document.querySelector('#marks i').style.left)") == pytest.approx(
        100 * 3.4 / 5, abs=0.5
    )
    file.click_on("#findings [data-at]")
    assert now(file) == pytest.approx(3.4, abs=1e-3)


def test_the_camera_turns_where_the_mouse_drags(file):
    seek(file, 0.0)
    before, turned = file.picture(), file.run("regrasp.orbit.azimuth")
    for kind, x in (("mousePressed", 300), ("mouseMoved", 380), ("mouseReleased", 380)):
        file.ask("Input.dispatchMouseEvent", type=kind, x=x, y=300, button="left", buttons=1)
    assert file.run("regrasp.orbit.azimuth") < turned - 0.1
    assert np.sum(np.abs(file.picture() - before).max(axis=2) > 40) > 2000
    file.run("regrasp.fit()")


def test_the_file_asks_nobody_for_anything(file):
    assert not file.complaints
    assert all(url.startswith(("file:", "data:", "blob:")) for url in file.requests)


def test_a_served_page_hears_the_news(browser, plan):
    browser.requests.clear()
    with Server(pack(tell(plan)), port=0) as server:
        browser.open(server.url)
        browser.run("regrasp.patience = Infinity")
        assert "being checked" in browser.run("document.querySelector('#verdict').textContent")
        server.news("certificate", {"certificate": Certificate((FINE,)).to_dict()})
        browser.until("document.querySelector('#verdict').textContent.includes('certified: 1')")
        browser.click_on("#cells [data-j='2'][data-i='0']")
        assert now(browser) == pytest.approx(plan.time[2, 0], abs=1e-3)
        layers(browser, "forces")
        assert np.sum(arrows(browser)) > 100
        server.news("search", {"stage": "segment 1", "done": 7, "total": 10, "curve": [[9.0, 9.0], [5.0, 4.0]]})
        server.story(pack(tell(replace(plan, force_W=np.zeros_like(plan.force_W)))))
        browser.until("regrasp.story.reach === 0")
        assert not arrows(browser).any()
        assert browser.run("document.querySelector('#search p').textContent") == "segment 1"
        assert browser.run("document.querySelector('#search progress').value") == 7
        assert now(browser) == pytest.approx(plan.time[2, 0], abs=1e-3)  # another story, the same time
        assert all(url.startswith((server.url, "data:", "blob:")) for url in browser.requests)
    assert not browser.complaints
