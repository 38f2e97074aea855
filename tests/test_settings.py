"""Settings that cannot be are refused before anything is built, with one line that says why."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from commands import assistax as assistax_command
from PIL import Image
from stored import small, stored_run, stored_team

import assistax
from assistax.cli.settings import listing, meanings
from assistax.cli.sweep import sweep
from assistax.cli.train import train
from assistax.diagnostics.bench import check_seconds
from assistax.errors import UsageError
from assistax.evaluation.film import Camera, check_format, film
from assistax.evaluation.filmed import Filmed
from assistax.evaluation.statistics import bootstrap_ci
from assistax.human import HumanConfig
from assistax.learning.algorithms import ALGORITHMS
from assistax.results.stored import flat
from assistax.settings import parse_assignments
from assistax.training.configuration import DEFAULT_STEPS, FLAGS, configure, to_json
from assistax.training.run import Run
from assistax.training.sweep import Sweep
from assistax.training.team_file import load_team


@pytest.mark.parametrize("name", FLAGS)
def test_what_has_a_flag_is_not_set_by_name(name, tmp_path):
    run = stored_run(tmp_path / "run", small())
    team = stored_team(tmp_path / "team.safetensors", small())
    for use in (
        lambda: configure("scratch", {name: 1}),
        lambda: Run.open(run.folder, {name: 1}),
        lambda: load_team(team, {name: 1}),
    ):
        with pytest.raises(UsageError, match=f"^{name} is chosen by "):
            use()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"env.reset_noise": -1}, "env.reset_noise must be 0 or more, not -1"),
        ({"env.force_limit": math.nan}, "env.force_limit must be a finite number"),
        ({"env.num_threads": -2}, "env.num_threads must be 0 or more"),
        ({"ppo.learning_rate": math.inf}, "ppo.learning_rate must be a finite number, not inf"),
        ({"ppo.entropy_coef": math.nan}, "ppo.entropy_coef must be a finite number"),
        ({"ppo.learning_rate": 10**400}, "ppo.learning_rate must be a finite number"),
        ({"ppo.value_coef": -1}, "ppo.value_coef must be 0 or more"),
        ({"ppo.final_log_std": "none"}, "ppo.final_log_std must be a finite number, or None, not 'none'"),
        ({"ppo.final_log_std": True}, "ppo.final_log_std must be a finite number"),
        ({"evaluations": -1}, "evaluations must be 1 or more"),
        ({"task_config.force": math.inf}, "task_config.force must be a finite number"),
    ],
)
def test_impossible_numbers_are_refused(settings, words):
    with pytest.raises(UsageError, match=words):
        configure("scratch", settings)


def test_the_rest_that_was_taken_though_wrong(tmp_path):
    for seconds in (-1.0, 0.0, math.nan):
        with pytest.raises(UsageError, match="seconds must be above 0"):
            check_seconds(seconds)
    with pytest.raises(UsageError, match="The width of a picture must be from 16 to 8192 pixels, not 0"):
        Camera("scratch", width=0)
    with pytest.raises(UsageError, match="must be even, not 641 x 480"):
        check_format(Path("film.mp4"), 641, 480)
    with pytest.raises(UsageError, match=r"--set has ppo\.gamma twice; leave out one"):
        parse_assignments(["ppo.gamma=0.9", "ppo.clip_eps=0.1", "ppo.gamma=0.99"])
    with pytest.raises(UsageError, match=r"ppo\.nosuch"):
        Sweep.create(small(), tmp_path / "sweep", 2, {"ppo.nosuch": "1:2"})
    with pytest.raises(UsageError, match="preset is chosen by --preset"):
        Sweep.create(small(), tmp_path / "sweep", 2, {"preset": "default,paper"})
    with pytest.raises(UsageError, match=r"sac\.hidden must be the sizes"):
        configure("scratch", {"sac.hidden": (-4,)}, algorithm="masac")
    assert bootstrap_ci([3.0]) is None and not (tmp_path / "sweep").exists()


def test_a_film_is_as_fast_as_what_it_shows(tmp_path, monkeypatch):
    """Of 8 s at 125 Hz: each frame is of the step nearest to the time at which it is shown."""
    shown, durations = [], []

    class Recorder:
        def __init__(self, *_, **__): ...
        def __enter__(self):
            return self

        def __exit__(self, *_): ...
        def picture(self, qpos, marker):
            shown.append(qpos[0])
            return np.full((16, 16, 3), 255 * (len(shown) % 2), np.uint8)

    monkeypatch.setattr("assistax.evaluation.film.Camera", Recorder)
    steps = np.arange(1000.0)[:, None]
    for suffix in (".webp", ".gif"):
        shown.clear()
        film(Filmed("scratch", 0.008, steps, steps), tmp_path / f"a{suffix}", view="main")
        with Image.open(tmp_path / f"a{suffix}") as picture:
            assert picture.n_frames == len(shown) == 80
            durations.append(picture.info.get("duration"))
        np.testing.assert_allclose(np.array(shown) * 0.008, np.arange(80) * 0.1, atol=0.0041)
    assert durations[1] == 100


def test_help_readme_and_code_agree_on_the_steps():
    words = f"{DEFAULT_STEPS / 1e6:g} million"
    for command in ("train", "sweep"):
        text = __import__(f"assistax.cli.{command}", fromlist=[command]).__dict__[command].__doc__
        assert f"(default {words}" in text
    readme = Path(assistax.__file__).parents[2] / "README.md"
    assert f"{words} steps by default" in readme.read_text()


def test_every_setting_is_listed_with_its_default_and_meaning():
    """By name against the configurations themselves; what has a flag of its own is not there."""
    for algorithm in ALGORITHMS:
        config = configure("feeding", {}, algorithm=algorithm)
        asked = json.loads(json.dumps(to_json(config)))
        rows = listing("feeding", algorithm)
        known = {name: value for name, value in flat(asked) if name not in {*FLAGS, "partner_copies"}}
        assert rows.keys() == known.keys()
        assert {name: json.loads(json.dumps(default)) for name, (default, _) in rows.items()} == known
        assert not [name for name, (_, meaning) in rows.items() if not meaning and "task_config" not in name]


def test_meanings_are_the_comments_above_and_behind():
    found = meanings(HumanConfig)
    assert found["visibility"].startswith(
        'Who sees the preference: "both" (the paper), "human" or "none". With "shown"'
    )
    assert found["preference"].startswith('"none": no preference reward;') and '"speed=0.05' in found["preference"]


def test_the_command_lists_them_and_help_names_it():
    lines = assistax_command("settings", "scratch").stdout.splitlines()
    for name, (default, _) in listing("scratch").items():
        assert [line for line in lines if line.startswith(f"{name}={default}")], name
    assert {"ppo.gamma", "sac.tau", "env.human.people", "task_config.force"} < listing("scratch").keys()
    assert not [name for name in listing() if name.startswith("task_config")]
    stored = json.loads(
        assistax_command("settings", "feeding", "--algorithm", "mappo", "--preset", "paper", "--json").stdout
    )
    assert stored["ppo.learning_rate"] == {"default": 1.54e-3, "meaning": "of Adam, for actors and critics"}
    assert "sac.tau" not in stored
    for command in (train, sweep):
        assert "`assistax settings TASK` lists" in command.__doc__


def test_words_in_a_list_are_written_with_commas():
    teachers = parse_assignments(["ppo.teachers=human=offers_slowly,robot=expert"])
    assert configure("scratch", teachers).method.teachers == ("human=offers_slowly", "robot=expert")
    assert configure("scratch", parse_assignments(["ppo.teachers="])).method.teachers == ()
    with pytest.raises(UsageError, match=r"ppo.hidden must be a list like \(1, 2\), not 'wide'"):
        configure("scratch", {"ppo.hidden": "wide"})


def test_a_setting_without_its_group_is_found_in_it():
    with pytest.raises(UsageError, match=r"Unknown setting 'episode_length'. Did you mean 'env.episode_length'\?"):
        configure("scratch", {"episode_length": 5})
    with pytest.raises(UsageError, match=r"Unknown setting 'human'. Did you mean 'env.human.preference'\?"):
        configure("scratch", {"human.preference": "sweep"})
