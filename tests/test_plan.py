"""A plan is immutable, says what is wrong with its arrays, and survives being written and read."""

import dataclasses
import io
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp.errors import InputError
from regrasp.plan import ARRAYS, MOTIONS, VERSION, Plan, load

LENGTHS = {"N": 2, "M": 4, "k": 3, "nq": 7, "P": 1, "B": 3, "L": 5}


def a_plan(**changes: object) -> Plan:
    rng = np.random.default_rng(0)
    arrays = {
        name: rng.normal(size=[LENGTHS.get(n, n) for n in shape]).astype(dtype)
        for name, (dtype, shape) in ARRAYS.items()
    }
    arrays["p_OC_O"][0, :, 1] = np.nan
    values = arrays | {
        "support_names": ("table",), "agent_names": ("a", "b", "c"), "joint_names": tuple("1234567"),
        "scene": {"name": "test", "friction": 0.7}, "xml": "<mujoco/>", "assets": {"a/b.stl": b"\x00\xffsolid"},
        "seed": 3, "settings": {"weights": [1.0, 2.0]}, "versions": {"regrasp": "0.1.0"}, "feasible": True,
        "remarks": ("längs",),
    }  # fmt: skip
    return Plan(**values | changes)


def rewrite(path: Path, change) -> None:
    """Apply `change` to the entries of the archive (name: bytes)."""
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    change(entries)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)


def manifest_bytes(text: str) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.frombuffer(text.encode(), dtype=np.uint8))
    return buffer.getvalue()


def test_survives_the_file(tmp_path):
    plan = a_plan()
    plan.save(tmp_path / "plan.npz")
    read = load(tmp_path / "plan.npz")
    for field in dataclasses.fields(Plan):
        ours, theirs = getattr(plan, field.name), getattr(read, field.name)
        if field.name in ARRAYS:
            assert ours.dtype == theirs.dtype
            np.testing.assert_array_equal(ours, theirs)
        else:
            assert ours == theirs, field.name


def test_same_plan_same_bytes(tmp_path):
    a_plan().save(tmp_path / "a")
    load(tmp_path / "a").save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_is_immutable():
    mine = np.zeros((2, 4))
    plan = a_plan(time=mine)
    mine[0, 0] = 7.0
    assert plan.time[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        plan.time[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        plan.seed = 4  # type: ignore[misc]


@given(st.sampled_from(sorted(ARRAYS)), st.data())
@settings(max_examples=60, deadline=None)
def test_a_wrong_shape_is_named(name, data):
    array = getattr(a_plan(), name)
    axis = data.draw(st.integers(0, array.ndim - 1))
    longer = np.concatenate([array, np.take(array, [0], axis=axis)], axis=axis)
    for wrong in (longer, array[None]):
        free = ARRAYS[name][1] == ("B", 7) and wrong.ndim == 2 and axis == 0
        if free:  # any number of subgoals is legal
            continue
        with pytest.raises(InputError) as error:
            a_plan(**{name: wrong})
        text = str(error.value)
        assert str(wrong.shape) in text or name == "time" or name == "energy"
        assert "wanted" in text


def test_a_wrong_dtype_is_named():
    with pytest.raises(InputError, match=r"plan\.V: dtype int64 \(wanted int8\)"):
        a_plan(V=np.zeros((2, 3), dtype=np.int64))


@pytest.mark.parametrize(("letter", "field"), [("N", "time"), ("M", "time"), ("B", "route")])
def test_too_little_is_named(letter, field):
    arrays = {}
    for name, (dtype, shape) in ARRAYS.items():
        if letter in shape:
            lengths = LENGTHS | {letter: 0 if letter == "N" else 1}
            arrays[name] = np.zeros([lengths.get(n, n) for n in shape], dtype=dtype)
    with pytest.raises(InputError, match=rf"plan\.{field}: {letter} = "):
        a_plan(**arrays)


def test_saving_over_a_plan_is_all_or_nothing(tmp_path, monkeypatch):
    path = tmp_path / "plan.npz"
    a_plan().save(path)
    before = path.read_bytes()
    with pytest.raises(InputError, match="not JSON"):
        a_plan(settings={"a": float("nan")}).save(path)
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        a_plan(seed=9).save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["plan.npz"]


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.npz: plan: No such file"):
        load(tmp_path / "none.npz")


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04", b"\x93NUMPY"])
def test_another_file_is_no_plan(tmp_path, content):
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(InputError, match="not a plan"):
        load(tmp_path / "x")


@given(st.floats(0.0, 0.999))
@settings(max_examples=30, deadline=None)
def test_a_truncated_file_is_refused(tmp_path_factory, part):
    path = tmp_path_factory.mktemp("cut") / "plan.npz"
    a_plan().save(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    with pytest.raises(InputError, match="plan"):
        load(path)


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_damaged_file_is_refused_or_unharmed(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("flip") / "plan.npz"
    plan = a_plan()
    plan.save(path)
    content = bytearray(path.read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    try:
        read = load(path)
    except InputError:
        return
    for name in ARRAYS:  # the flip hit a field of the archive that says nothing, such as a date
        np.testing.assert_array_equal(getattr(plan, name), getattr(read, name))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda e: e.pop("force_W.npy"), r"plan\.force_W: is missing"),
        (lambda e: e.pop("manifest.npy"), "damaged or not a plan"),
        (lambda e: e.pop("asset0.npy"), r"plan\.assets: is missing a file"),
        (lambda e: e.update({"manifest.npy": manifest_bytes("{")}), r"plan\.manifest: is not JSON"),
        (lambda e: e.update({"manifest.npy": manifest_bytes("[]")}), r"plan\.manifest\.format"),
        (lambda e: e.update({"manifest.npy": manifest_bytes('{"a": NaN}')}), r"plan\.manifest: holds NaN"),
        (
            lambda e: e.update(
                {"manifest.npy": manifest_bytes(json.dumps({"format": "regrasp plan", "version": VERSION + 1}))}
            ),
            rf"plan\.manifest\.version: is {VERSION + 1} \(this regrasp reads {VERSION}\)",
        ),
        (
            lambda e: e.update(
                {"manifest.npy": manifest_bytes(json.dumps({"format": "regrasp plan", "version": VERSION}))}
            ),
            "is missing",
        ),
    ],
)
def test_a_mutilated_archive_is_refused(tmp_path, change, message):
    path = tmp_path / "plan.npz"
    a_plan().save(path)
    rewrite(path, change)
    with pytest.raises(InputError, match=message):
        load(path)


def test_pickles_are_refused(tmp_path):
    path = tmp_path / "plan.npz"
    a_plan().save(path)
    buffer = io.BytesIO()
    np.save(buffer, np.array([{}], dtype=object), allow_pickle=True)
    rewrite(path, lambda entries: entries.update({"time.npy": buffer.getvalue()}))
    with pytest.raises(InputError, match="not a plan"):
        load(path)


def test_the_summary_counts():
    V = np.array([[0, 9, 10], [0, 1, 10]], dtype=np.int8)
    time = np.array([[0.0, 1.0, 2.0, 3.0], [3.0, 4.0, 5.0, 6.5]])
    summary = a_plan(V=V, time=time).summary()
    assert summary["motions"] == {"stay": 2, "roll+x": 1, "relocate": 1, "off": 2}
    assert (summary["intervals"], summary["samples"], summary["segments"], summary["duration"]) == (2, 4, 2, 6.5)
    assert json.loads(json.dumps(summary, allow_nan=False))["scene"] == "test"


def test_there_are_eleven_contact_motions():
    assert len(set(MOTIONS)) == len(MOTIONS) == 11
