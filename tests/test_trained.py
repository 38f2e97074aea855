"""The trained teams that come with the package do what they are for."""

import pytest

from assistax.evaluation.playing import play
from assistax.training.team_file import TRAINED, load_team, trained_file


@pytest.mark.parametrize("path", sorted(TRAINED.glob("*.safetensors")), ids=lambda path: path.stem)
def test_a_trained_team_succeeds(path):
    assert path == trained_file(path.stem) and path.stat().st_size < 150_000
    env, team = load_team(path, engine="mujoco")
    assert env.name == path.stem
    assert play(env, team, 8)["metrics"]["success"].mean() >= 0.5
