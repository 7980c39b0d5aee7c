"""The contract of the command line: exit codes, one line or one JSON object, nothing imported that is not needed."""

import base64
import dataclasses
import json
import re
import subprocess
import sys
import types
import urllib.request
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from regrasp.cli import main
from regrasp.plan import Plan, load
from regrasp.scene.load import builtin, validate
from regrasp.scene.load import load as load_scene
from regrasp.verify.findings import Certificate, Finding


@dataclasses.dataclass(frozen=True)
class Annealing:
    iterations: int = 4000
    final: float = 1e-3

    def __post_init__(self) -> None:
        if not 0 < self.final <= 1:
            raise ValueError(f"final is {self.final}, legal: 0 < final ≤ 1")


@dataclasses.dataclass(frozen=True)
class Local:
    annealing: Annealing = dataclasses.field(default_factory=Annealing)


@dataclasses.dataclass(frozen=True)
class Settings:
    """The planner's settings, as far as the command line needs them."""

    time_limit: float = 0.0
    local: Local = dataclasses.field(default_factory=Local)


@dataclasses.dataclass(frozen=True)
class Failure:
    constraint: str = "equilibrium"
    where: str = "arc 1 of 2, interval 3"
    agent: str = "finger2"
    reason: str = "no forces balance the weight"
    remedy: str = "more friction"

    def __str__(self) -> str:
        return f"{self.constraint}: {self.where}: {self.agent}: {self.reason} ({self.remedy})"


Planner = Callable[..., types.SimpleNamespace]


@pytest.fixture
def planner(monkeypatch: pytest.MonkeyPatch) -> Callable[[Planner], list[tuple]]:
    """Puts a planner in the place of the real one; the list fills with what it was called with."""

    def put(plan_scene: Planner) -> list[tuple]:
        calls: list[tuple] = []

        def called(scene, seed, settings, progress):
            calls.append((scene, seed, settings))
            progress(types.SimpleNamespace(stage="annealing", done=1, total=2, energy=3.0, best=2.0))
            print("a library that prints")
            return plan_scene()

        module = types.ModuleType("regrasp.planner.method")
        module.plan_scene = called
        monkeypatch.setitem(sys.modules, "regrasp.planner.method", module)
        module = types.ModuleType("regrasp.planner.task")
        module.Settings = Settings
        monkeypatch.setitem(sys.modules, "regrasp.planner.task", module)
        return calls

    return put


def outcome(plan: Plan | None = None, failure: Failure | None = None) -> types.SimpleNamespace:
    return types.SimpleNamespace(plan=plan, failure=failure, tried=(), repairs=())


def interrupted() -> types.SimpleNamespace:
    raise KeyboardInterrupt


def scene_file(directory: Path, planner: str) -> Path:
    path = directory / "mine.yaml"
    path.write_text(
        "name: mine\nmodel: {hand: puma}\nobject: {shape: sphere, size: [0.03], mass: 0.1}\n"
        "start: {pose: {position: [0, 0, 0.2]}}\ngoal: {pose: {position: [0, 0, 0.22]}}\n" + planner
    )
    return path


def test_help_and_version_load_no_library():
    code = (
        "import sys; from regrasp.cli import main; main(['--help']); main(['--version']);"
        "heavy = 'numpy', 'numba', 'mujoco', 'scipy', 'pydantic', 'tyro', 'rich', 'matplotlib', 'clarabel', 'yaml', 'PIL';"
        "print([m for m in heavy if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    assert all(name in done.stdout for name in ("plan", "check", "replay", "scenes", "view", "render", "bench"))


def test_planning_imports_what_planning_needs() -> None:
    """All that comes before the planner's first kernel: most of what a short run lasts, were these imported too."""
    code = (
        "import sys; from regrasp.cli import main; from regrasp.view.progress import Reporter;"
        "assert main(['plan', 'fig4-relocaton', '-o', 'plan.npz']) == 2; assert 'regrasp.planner.method' in sys.modules;"
        "idle = 'scipy.linalg', 'scipy.sparse', 'scipy.spatial', 'scipy.interpolate', 'matplotlib', 'rich', 'glfw',"
        "'highspy', 'typeguard', 'PIL';"
        "print([m for m in idle if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    assert "fig4-relocation?" in done.stderr


@pytest.mark.parametrize(
    "command", ["plan", "check", "replay", "grasp", "scenes", "models", "doctor", "view", "render", "bench"]
)
def test_every_command_has_help(command, capsys, planner):
    planner(outcome)
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert not end.value.code
    assert f"usage: regrasp {command}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["chek", "x"], "check?"),
        (["scenes", "--foo"], "--foo"),
        (["doctor", "none.urdf"], "none.urdf"),
        (["doctor"], "SCENE|MODEL"),
        (["check"], "PLAN"),
        (["check", "missing.npz"], "missing.npz"),
        (["replay"], "PLAN"),
        (["replay", "missing.npz"], "missing.npz"),
        (["replay", "x.npz", "--trails", "3"], "--trials"),
        (["replay", "x.npz", "--control.impedance.lever", "-1"], "lever"),
        (["render", "x.npz", "-o", "x.png", "--frames", "many"], "many"),
        (["render", "x.npz", "-o", "x.png", "--frmes", "3"], "--frames"),
        (["render", "x.npz", "-o", "x.jpg"], ".png"),
        (["render", "x.npz", "-o", "x.png", "--frames", "0"], "1 to 12"),
        (["grasp", "fig3-puma3", "--count", "0"], "1 to 12"),
        (["grasp", "fig3-puma3", "-o", "x.jpg"], ".png"),
        (["view", "x.npz"], "x.npz"),
        (["view", "x.npz", "--html", "nowhere/x.html"], "nowhere"),
        (["view", "--live", "x.yaml", "--replay"], "--live"),
        (["view", "--live", "no-such-scene"], "no-such-scene"),
        (["view", "x.npz", "--port", "many"], "many"),
        (["bench", "papers"], "minima"),
        (["bench", "scenes", "--seeds", "0"], "--seeds"),
        (["bench", "scenes", "--scenes", "peg"], "peg-hole"),
        (["bench", "paper", "--scenes", "peg-hole"], "scenes and replays"),
        (["plan", "fig3-puma3"], "--output"),
        (["plan", "fig3-puma", "-o", "x.npz"], "fig3-puma3"),
        (["plan", "missing.yaml", "-o", "x.npz"], "missing.yaml"),
        (["plan", "fig3-puma3", "-o", "no/such/x.npz"], "no/such"),
        (["plan", "fig3-puma3", "-o", "x.npz", "--planner.local.annealing.final", "2"], "0 < final ≤ 1"),
        (["plan", "fig3-puma3", "-o", "x.npz", "--iterations", "few"], "--iterations"),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_bad_input_is_one_line_and_exit_2(arguments, words, as_json, capsys, planner, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    calls = planner(outcome)
    assert main([*arguments, "--json"] if as_json else arguments) == 2
    out, err = capsys.readouterr()
    assert words in err
    assert err.count("\n") == 1
    if as_json:
        assert json.loads(out)["error"] == err.strip()
    else:
        assert out == ""
    assert not calls
    assert not list(tmp_path.iterdir())


def test_scene_errors_name_file_and_field(capsys, planner, tmp_path):
    path = scene_file(tmp_path, "planner: {local: {anealing: {iterations: 3}}}\n")
    planner(outcome)
    assert main(["plan", str(path), "-o", str(tmp_path / "x.npz")]) == 2
    assert "planner.local.anealing: unknown key (annealing?)" in capsys.readouterr().err
    path.write_text(path.read_text().replace("mass: 0.1", "mass: -1"))
    assert main(["plan", str(path), "-o", str(tmp_path / "x.npz")]) == 2
    assert f"{path}: object.mass" in capsys.readouterr().err


def test_plan_writes_the_plan_and_says_so_once(capsys, planner, home_plan, tmp_path):
    plan = home_plan("fig3-puma3")
    calls = planner(lambda: outcome(plan))
    target = tmp_path / "x.npz"
    assert main(["plan", "fig3-puma3", "-o", str(target), "--seed", "7", "--json"]) == 0
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert answer["plan"] == str(target)
    assert answer["intervals"] == len(plan.V)
    assert answer["energy"] == 1.0
    assert "annealing: 1/2, energy 3, best 2" in err
    assert "a library that prints" in err
    assert np.array_equal(load(target).V, plan.V)
    (scene, seed, settings) = calls[0]
    assert (scene.name, seed, settings) == ("fig3-puma3", 7, Settings())


def test_flags_override_the_scene_which_overrides_the_defaults(planner, home_plan, tmp_path):
    path = scene_file(tmp_path, "planner: {time_limit: 3, local: {annealing: {iterations: 100, final: 0.5}}}\n")
    calls = planner(lambda: outcome(home_plan("fig3-puma3")))
    arguments = ["plan", str(path), "-o", str(tmp_path / "x.npz")]
    assert main(arguments) == 0
    assert main([*arguments, "--iterations", "9", "--planner.local.annealing.final", "0.25"]) == 0
    assert main([*arguments, "--time-limit", "1.5"]) == 0
    assert [settings for _, _, settings in calls] == [
        Settings(3.0, Local(Annealing(100, 0.5))),
        Settings(3.0, Local(Annealing(9, 0.25))),
        Settings(1.5, Local(Annealing(100, 0.5))),
    ]


def test_no_plan_is_exit_1_with_reason_and_remedy(capsys, planner, tmp_path):
    planner(lambda: outcome(failure=Failure()))
    arguments = ["plan", "fig3-puma3", "-o", str(tmp_path / "x.npz"), "--json"]
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert json.loads(out)["failure"] == dataclasses.asdict(Failure())
    assert "finger2: no forces balance the weight (more friction)" in err
    assert not (tmp_path / "x.npz").exists()


def test_interrupt_is_exit_130_without_traceback(capsys, planner, tmp_path):
    planner(interrupted)
    assert main(["plan", "fig3-puma3", "-o", str(tmp_path / "x.npz")]) == 130
    assert capsys.readouterr().err.endswith("interrupted\n")
    assert not (tmp_path / "x.npz").exists()


@pytest.mark.parametrize(("value", "code"), [(0.5, 0), (2.0, 1), (np.nan, 1)])
def test_check_exits_by_the_certificate(value, code, capsys, monkeypatch, home_plan, tmp_path):
    finding = Finding("gap", "contact gap", value, 1.0, "mm", interval=3, who="finger1")
    monkeypatch.setattr("regrasp.verify.check.check", lambda plan: Certificate((finding,)))
    path = tmp_path / "x.npz"
    home_plan("fig3-puma3").save(path)
    assert main(["check", str(path), "--json"]) == code
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert answer["passed"] is (code == 0)
    assert answer["findings"][0]["who"] == "finger1"
    assert ("refused: gap" in err) is (code == 1)
    assert main(["check", str(path)]) == code
    assert "contact gap" in capsys.readouterr().out


def test_check_refuses_fingers_that_touch_nothing(capsys, home_plan, tmp_path):
    path = tmp_path / "x.npz"
    home_plan("fig3-puma3").save(path)
    assert main(["check", str(path), "--json"]) == 1
    assert not json.loads(capsys.readouterr().out)["passed"]


def test_check_of_a_file_that_is_no_plan(capsys, tmp_path):
    path = tmp_path / "x.npz"
    path.write_text("nothing of the kind")
    assert main(["check", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_view_writes_a_file_with_the_certificate_in_it(capsys, monkeypatch, home_plan, tmp_path):
    finding = Finding("gap", "contact gap", 2.0, 1.0, "mm", interval=3, who="finger1")
    monkeypatch.setattr("regrasp.verify.check.check", lambda plan: Certificate((finding,)))
    path, file = tmp_path / "x.npz", tmp_path / "x.html"
    home_plan("fig3-puma3").save(path)
    assert main(["view", str(path), "--html", str(file), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["html"], answer["bytes"]) == (str(file), file.stat().st_size)
    story = re.search(r'id="story">([^<]*)<', file.read_text("utf-8"))
    assert story is not None
    assert b'"who": "finger1"' in zlib.decompress(base64.b64decode(story[1]))


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("0.0.0.0", True)])
def test_view_serves_a_page_and_warns_if_others_reach_it(host, warned, capsys, monkeypatch, home_plan, tmp_path):
    seen = []

    def look() -> None:
        """As a browser does while the command waits to be interrupted."""
        url = capsys.readouterr().err
        with urllib.request.urlopen(re.search(r"http\S+", url)[0].replace("0.0.0.0", "127.0.0.1"), timeout=10) as page:
            seen.append((url, page.read()))

    monkeypatch.setattr("regrasp.verify.check.check", lambda plan: Certificate(()))
    monkeypatch.setattr("regrasp.commands.viewing._wait", look)
    path = tmp_path / "x.npz"
    home_plan("fig3-puma3").save(path)
    assert main(["view", str(path), "--host", host, "--port", "0", "--no-browser"]) == 0
    ((said, page),) = seen
    assert b"<!doctype html>" in page
    assert ("--host" in said) is warned


def test_view_opens_the_browser_unless_told_not_to(monkeypatch, home_plan, tmp_path):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("regrasp.verify.check.check", lambda plan: Certificate(()))
    monkeypatch.setattr("regrasp.commands.viewing._wait", lambda: None)
    path = tmp_path / "x.npz"
    home_plan("fig3-puma3").save(path)
    assert main(["view", str(path), "--port", "0"]) == 0
    assert main(["view", str(path), "--port", "0", "--no-browser"]) == 0
    assert len(opened) == 1
    assert opened[0].startswith("http://127.0.0.1:")


def test_view_live_ends_with_the_plan_that_was_found(capsys, monkeypatch):
    found = []

    def look() -> None:
        url = re.search(r"http\S+", capsys.readouterr().err)
        assert url is not None
        with urllib.request.urlopen(url[0] + "story", timeout=10) as story:
            content = zlib.decompress(story.read())
        found.append(json.loads(content[4 : 4 + int.from_bytes(content[:4], "little")]))

    monkeypatch.setattr("regrasp.commands.viewing._wait", look)
    assert main(["view", "--live", "fig2-planar", "--port", "0", "--no-browser", "--json"]) == 0
    (header,) = found
    assert (header["name"], header["draft"]) == ("fig2-planar", False)
    assert header["arrays"]["V"]["shape"][1] == len(header["agents"])
    assert json.loads(capsys.readouterr().out)["scene"] == "fig2-planar"


def test_grasps_are_shown_as_lines_of_a_scene_file(capsys, tmp_path):
    assert main(["grasp", "fig2-planar", "--count", "2", "-o", str(tmp_path / "grasps.png")]) == 0
    text = capsys.readouterr().out
    first = text[text.index("start:") :].split("grasp 2:")[0]
    start = yaml.safe_load(first)["start"]
    data = load_scene("fig2-planar").model_dump(mode="json")
    data["start"].update(start)
    assert {contact.agent for contact in validate(data).start.grasp} <= {"finger1", "finger2", "finger3"}
    with Image.open(tmp_path / "grasps.png") as picture:
        assert picture.width > picture.height


def test_scenes_lists_the_built_in_ones(capsys):
    assert main(["scenes", "--json"]) == 0
    names = {scene["name"] for scene in json.loads(capsys.readouterr().out)["scenes"]}
    assert {"fig2-planar", "fig3-puma3", "fig4-relocation", "puma4-obstacles"} <= names


def test_models_lists_hands_with_their_fields_and_the_menagerie(capsys, monkeypatch, tmp_path):
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    assert main(["models"]) == 0
    printed = capsys.readouterr().out
    assert "puma: fingers (3), scale (0.3)" in printed
    assert "MENAGERIE_ROOT is not set" in printed
    (tmp_path / "maker_arm").mkdir()
    (tmp_path / "maker_arm" / "arm.xml").write_text("<mujoco/>")
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    assert main(["models", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert {"puma", "planar", "allegro"} <= answer["hands"].keys()
    assert answer["hands"]["planar"]["bases"] == "required"
    assert (answer["menagerie"], answer["root"]) == (["maker_arm/arm"], str(tmp_path))


@pytest.mark.parametrize(("y", "code"), [(0, 0), (5, 1)])
def test_doctor_exits_by_whether_there_is_an_error(y, code, capsys, tmp_path):
    scene = scene_file(tmp_path, "")
    scene.write_text(scene.read_text().replace("[0, 0, 0.2", f"[0, {y}, 0.2"))
    assert main(["doctor", str(scene), "--json"]) == code
    answer = json.loads(capsys.readouterr().out)
    errors = [symptom for symptom in answer["symptoms"] if symptom["severity"] == "error"]
    assert len(errors) == 3 * code
    assert main(["doctor", str(scene)]) == code
    printed = capsys.readouterr().out
    assert printed.count("error: agent 'finger") == 3 * code
    assert printed.endswith(f"{scene}: {3 * code} errors, 0 warnings, 0 notes\n")


def test_what_was_repaired_is_said_before_the_plan_on_stderr(capsys, planner, home_plan, tmp_path):
    done = outcome(home_plan("fig3-puma3"))
    done.repairs = ("body 'hand' has no inertia",)
    planner(lambda: done)
    assert main(["plan", "fig3-puma3", "-o", str(tmp_path / "a.npz"), "--json"]) == 0
    printed = capsys.readouterr()
    assert "fig3-puma3: body 'hand' has no inertia" in printed.err.splitlines()
    assert json.loads(printed.out)["repairs"] == ["body 'hand' has no inertia"]


@pytest.mark.parametrize(("passed", "code"), [(True, 0), (False, 1)])
def test_bench_passes_seeds_and_exits_by_its_result(passed, code, capsys, monkeypatch):
    module = types.ModuleType("regrasp.bench.scenes")
    module.scenes = lambda seeds, names: {"passed": passed, "seeds": seeds, "names": list(names)}
    monkeypatch.setitem(sys.modules, "regrasp.bench.scenes", module)
    for asked, names in (([], list(builtin())), (["--scenes", "peg-hole"], ["peg-hole"])):
        assert main(["bench", "scenes", "--seeds", "3", "--json", *asked]) == code
        answer = {"exit": code, "bench": "scenes", "passed": passed, "seeds": 3, "names": names}
        assert json.loads(capsys.readouterr().out) == answer


def test_the_short_flags_name_fields_of_the_planner():
    from regrasp.commands import planning
    from regrasp.planner.task import Settings as Real

    for path in (planning.ITERATIONS, planning.TIME_LIMIT):
        value: object = Real()
        for name in path:
            value = getattr(value, name)
        assert isinstance(value, int | float)
