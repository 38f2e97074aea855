"""What is measured, in which order, and that a later call goes on."""

import json
import timeit

import mujoco
import pytest

import assistax
from assistax import stamp
from assistax.cli.bench import bench
from assistax.diagnostics import measurements
from assistax.diagnostics.bench import bench_training
from assistax.diagnostics.measurements import MANY_SEEDS, Measurement, measure, newest_tasks, plan
from assistax.diagnostics.profile import STAGES, stage_times
from assistax.errors import UsageError


def test_every_task_once_before_any_other_size():
    tasks = newest_tasks()
    assert tasks[:2] == ["scratch-v3", "bed_bath-v3"] and len(set(tasks)) == len(tasks) >= 5
    wanted = plan(tasks, "auto", (), True, "default")
    assert wanted[: len(tasks)] == [Measurement(task, "mujoco", 1024) for task in tasks]
    assert wanted[len(tasks) : 2 * len(tasks)] == [Measurement(t, "mujoco", None, "default", 1) for t in tasks]
    assert len(set(wanted)) == len(wanted) and {one.num_envs for one in wanted} == {1024, 256, 64, 16, 1, None}
    assert plan(["feeding-v3"], "auto", (8,), True, "paper") == [
        Measurement("feeding-v3", "mujoco", 8),
        Measurement("feeding-v3", "mujoco", 8, "paper", 1),
    ]


def test_an_accelerator_trains_at_every_size_and_many_seeds(monkeypatch):
    monkeypatch.setattr(measurements.jax, "default_backend", lambda: "gpu")
    wanted = plan(["feeding-v3"], "warp", (), True, "default")
    assert {one.num_envs for one in wanted if one.preset} == {*measurements.ACCELERATOR_SIZES, None}
    assert Measurement("feeding-v3", "warp", None, "default", MANY_SEEDS) in wanted


def counted(monkeypatch):
    made = []

    def measured(self, seconds):
        made.append(self)
        rate = {"training_steps_per_s" if self.preset else "env_steps_per_s": 1000}
        of = {"task": self.task, "engine": self.engine, "preset": self.preset}
        return {"of": of | {"num_envs": self.num_envs, "num_seeds": self.num_seeds}, **of, "num_envs": 4} | rate

    monkeypatch.setattr(Measurement, "measure", measured)
    return made


def test_a_later_call_makes_what_is_missing(tmp_path, monkeypatch, capsys):
    made, out = counted(monkeypatch), tmp_path / "here.json"
    bench(all=True, budget="1s", seconds=1.0, out=out)
    first = len(made)
    everything = plan(newest_tasks(), "auto", (), True, "default")
    assert first == len(everything)  # none of these took any time
    bench(all=True, seconds=1.0, out=out)
    assert len(made) == first and out.with_suffix(".png").exists()
    assert [row["of"]["task"] for row in json.loads(out.read_text())["rows"]] == [one.task for one in everything]
    assert "1,000 steps/s" in capsys.readouterr().out


def test_nothing_begins_after_the_budget_but_the_first(tmp_path, monkeypatch):
    made, said = counted(monkeypatch), []
    wanted = plan(["feeding-v3"], "auto", (4, 2, 1), False, "default")
    path = tmp_path / "here.json"
    measure(wanted, path, 1.0, -1.0, said.append)
    assert made == wanted[:1] and said[-1].startswith("The budget is spent; the same command ")
    assert said[-1].endswith("measures the 2 of 3 that are left.")
    measure(wanted, path, 1.0, -1.0, said.append)
    assert made == wanted[:2]
    measure(wanted, None, 1.0, -1.0, said.append)
    assert made[2:] == wanted[:1] and "; with --out FILE another call can measure the 2 of 3 " in said[-1]


def test_json_is_all_that_is_printed_and_what_is_left_is_said_beside_it(monkeypatch, capsys):
    counted(monkeypatch)
    bench("feeding", num_envs=(4, 2), budget="0.000001s", seconds=1.0, json=True)
    printed = capsys.readouterr()
    assert len(json.loads(printed.out)["rows"]) == 1 and "the 1 of 2 that are left" in printed.err


def test_files_of_other_code_are_not_gone_on_with(tmp_path, monkeypatch):
    counted(monkeypatch)
    path = tmp_path / "here.json"
    wanted = plan(["feeding-v3"], "auto", (4,), False, "default")
    report = measure(wanted, path, 1.0, 60.0)
    path.write_text(json.dumps(report | {"hardware": "an abacus"}))
    with pytest.raises(UsageError, match="measured with other hardware; give another --out"):
        measure(wanted, path, 1.0, 60.0)
    for damaged in ('{"rows": 3}', '{"rows": [{}], "hardware": "x"}', "[]", '{"rows": [{"of": 1}]}'):
        path.write_text(damaged)
        with pytest.raises(UsageError, match="Cannot read") as error:
            measure(wanted, path, 1.0, 60.0)
        assert "\n" not in str(error.value)


def test_what_was_asked_for_is_shown_whatever_the_file_holds_beside_it(tmp_path, monkeypatch, capsys):
    counted(monkeypatch)
    for task in ("feeding", "scratch"):
        bench(task, seconds=1.0, out=tmp_path / "here.json")
        assert f"{task}-v3" in capsys.readouterr().out


@pytest.mark.parametrize(
    "asked, words",
    [
        ({}, "Name a task, or all of them with --all"),
        ({"task": "feeding", "all": True}, "Name a task, or all of them with --all"),
        ({"task": "feeding", "budget": "9"}, "A budget is a time like 90s"),
        ({"task": "feeding", "seconds": 0.0}, "seconds must be above 0"),
        ({"task": "fencing"}, "fencing"),
        ({"task": "feeding", "engine": "steam"}, "engine"),
        ({"task": "feeding", "num_envs": (0,)}, "num_envs must be 1 or more"),
        ({"task": "feeding", "num_envs": (10**9,)}, "1,000,000,000 environments would take .* GB of memory"),
        ({"task": "feeding", "num_envs": (10**8,), "train": True}, "would take .* GB of memory"),
        ({"task": "feeding", "train": True, "preset": "best"}, "preset"),
        ({"task": "feeding", "train": True, "profile": True}, "--profile is of one task at one size"),
        ({"task": "feeding", "num_envs": (1, 2), "profile": True}, "--profile is of one task at one size"),
        ({"all": True, "profile": True}, "--profile is of one task at one size"),
    ],
)
def test_malformed_calls_are_one_line(asked, words):
    with pytest.raises(UsageError, match=words) as error:
        bench(**asked)
    assert "\n" not in str(error.value)


def test_out_is_a_json_file_in_a_folder(tmp_path):
    for name, words in {"here.txt": "must end in .json", "none/here.json": "does not exist"}.items():
        with pytest.raises(UsageError, match=words):
            bench("feeding", out=tmp_path / name)


def test_training_is_timed_with_its_seeds():
    report = bench_training("scratch", "auto", 4, 0.01, num_seeds=2)
    assert report["task"] == "scratch-v3" and report["num_envs"] == 4 and report["rounds"] >= 3
    seconds = report["collect_s"] + report["update_s"]
    assert report["training_steps_per_s"] == pytest.approx(2 * 4 * 64 / seconds, rel=0.5)
    assert report["rollout_steps_per_s"] > report["training_steps_per_s"]


def test_memory_is_the_accelerators_where_there_is_one(monkeypatch):
    assert 50 < stamp.peak_memory_mb() < 50_000  # of this process

    class Accelerator:
        platform = "gpu"

        def memory_stats(self):
            return {"peak_bytes_in_use": 3 * 2**20}

    monkeypatch.setattr(measurements.jax, "devices", lambda: [Accelerator()])
    assert stamp.peak_memory_mb() == 3


def test_a_profile_adds_up_to_the_step(capsys):
    """Stage by stage what mj_step does by itself, timed apart; and the parts of a control step."""
    env = assistax.make("scratch", engine="mujoco", episode_length=64)
    stages, contacts, constraints = stage_times(env)
    assert set(stages) == {*STAGES, "integration"} and min(stages.values()) >= 0.0
    data = mujoco.MjData(env.model)
    mujoco.mj_resetDataKeyframe(env.model, data, 0)
    mujoco.mj_step(env.model, data)
    alone = 1e6 * min(timeit.repeat(lambda: mujoco.mj_step(env.model, data), number=20, repeat=20)) / 20
    assert 0.5 * alone < sum(stages.values()) < 2.5 * alone
    assert contacts >= 0.0 and constraints > 0.0
    bench("scratch", profile=True, num_envs=(4,), seconds=0.2, json=True)
    report = json.loads(capsys.readouterr().out)
    assert set(report["control_step_us"]) == {"physics", "transfer", "reset", "task"}
    assert report["physics_step_us"].keys() == stages.keys()
