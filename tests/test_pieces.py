"""Checkpoints whose large arrays lie in pieces: what is read is what was saved, whatever happens on the way."""

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax.errors import UsageError
from assistax.learning.sac.replay import add, init_replay
from assistax.pytree import pytree
from assistax.training import pieces
from assistax.training.checkpoint import load_checkpoint, save_checkpoint
from assistax.training.seeds import Lanes

ROW = {"obs": jnp.zeros(5), "actions": {"robot": jnp.zeros(2)}, "terminated": jnp.bool_(False)}
CAPACITY, CHUNK = 24, 4


@pytree
class State:
    params: dict[str, jax.Array]
    opt_state: jax.Array
    replay: Any
    key: jax.Array
    nothing: None = None


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(pieces, "PIECE", 64)
    monkeypatch.setattr(os, "fsync", lambda file: None)


def fresh(seed):
    params = {"w": jnp.full((8, 8), 0.5 + seed)}
    return State(params, jnp.zeros((8, 8)), init_replay(ROW, CAPACITY, CHUNK), jax.random.key(seed))


@jax.jit
def step(state):
    """What an iteration does to a state, without an environment."""
    key, new = jax.random.split(state.key)
    chunk = jax.tree.map(lambda x: jax.random.uniform(new, (CHUNK, *x.shape)).astype(x.dtype), ROW)
    params = jax.tree.map(lambda x: x + 1.0, state.params)
    return State(params, state.opt_state - 1.0, add(state.replay, chunk), key)


def lanes_of(count, side_by_side=False):
    lanes = Lanes(count)
    lanes._side_by_side = side_by_side
    return lanes


class Training:
    """Saves and resumes as the loop does."""

    def __init__(self, folder, lanes):
        self.folder, self.lanes = folder, lanes
        self.keys = range(lanes.count)
        folder.mkdir(exist_ok=True)

    def start(self):
        states = [fresh(seed) for seed in self.keys]
        return jax.tree.map(lambda *xs: jnp.stack(xs), *states) if self.lanes._side_by_side else states

    def step(self, state):
        return jax.vmap(step)(state) if self.lanes._side_by_side else [step(one) for one in state]

    def path(self, done):
        return self.folder / f"step_{done:012d}.safetensors"

    def save(self, state, done):
        pieces.save(self.path(done), self.lanes.join(state), {"done": done})
        for old in sorted(self.folder.glob("step_*.safetensors"))[:-2]:
            old.unlink()
        pieces.prune(self.folder)

    def load(self, done):
        like = jax.eval_shape(lambda: jax.tree.map(lambda *xs: jnp.stack(xs), *map(fresh, self.keys)))
        return self.lanes.split(pieces.load(self.path(done), like))


def assert_same(found, expected):
    for (path, a), b in zip(jax.tree.leaves_with_path(found), jax.tree.leaves(expected), strict=True):
        assert isinstance(a, jax.Array) and a.dtype == b.dtype
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        np.testing.assert_array_equal(a, b, err_msg=jax.tree_util.keystr(path))


def bytes_in(folder):
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize(("count", "every"), [(1, 1), (3, 5), (1, 7)])  # chunks between saves; the ring holds six
def test_a_ring_comes_back_however_often_it_went_round(tmp_path, count, every):
    training = Training(tmp_path / "run", lanes_of(count))
    state, saved, sizes = training.start(), {}, []
    training.save(state, 0)
    for done in range(1, 4 * CAPACITY // CHUNK):
        state = training.step(state)
        if done % every == 0:
            training.save(state, done)
            saved[done] = state
            sizes.append(bytes_in(training.folder))
            for kept in list(saved)[-2:]:
                assert_same(training.load(kept), saved[kept])
    assert len(list(training.folder.glob("*.safetensors"))) == 2
    assert max(sizes[2:]) < 1.2 * sizes[-1]


def test_what_is_there_is_not_written_again(tmp_path):
    training = Training(tmp_path, lanes_of(1))
    state = training.start()
    for _ in range(7):
        state = training.step(state)
    training.save(state, 7)
    before = set(training.folder.glob("pieces/*"))
    training.save(training.step(state), 8)
    after = set(training.folder.glob("pieces/*"))
    pieces_of = {"obs": CHUNK * 20 / 64 + 2, "robot": CHUNK * 8 / 64 + 2, "opt_state": 1}
    assert before < after and len(after - before) <= sum(pieces_of.values())


def test_what_plays_is_in_the_checkpoint_itself(tmp_path):
    training = Training(tmp_path, lanes_of(1))
    training.save(training.start(), 0)
    shutil.rmtree(tmp_path / "pieces")
    like = {"w": jax.ShapeDtypeStruct((1, 8, 8), jnp.float32)}
    np.testing.assert_array_equal(load_checkpoint(training.path(0), like, ".params")["w"], 0.5)


def test_seeds_saved_in_turn_resume_side_by_side_and_back(tmp_path):
    trainings = [Training(tmp_path, lanes_of(3, side_by_side)) for side_by_side in (False, True)]
    states = [training.step(training.start()) for training in trainings]
    for training, other in (trainings, trainings[::-1]):
        training.save(states[trainings.index(training)], 1)
        assert_same(other.load(1), states[trainings.index(other)])


def test_a_checkpoint_in_one_file_as_of_earlier_versions(tmp_path):
    training = Training(tmp_path, lanes_of(2))
    state = training.step(training.start())
    save_checkpoint(training.path(1), jax.tree.map(lambda *xs: jnp.stack(xs), *state), {"done": 1})
    assert_same(training.load(1), state)
    training.save(training.step(state), 2)
    assert_same(training.load(1), state)


# -- what can go wrong -------------------------------------------------------------------------


class Killed(BaseException):
    pass


def killed_at(monkeypatch, count):
    """A kill in place of the `count`th change of a name on the disk."""
    left = [count]

    def counted(change):
        def call(*args, **kwargs):
            if left[0] == 0:
                raise Killed
            left[0] -= 1
            return change(*args, **kwargs)

        return call

    monkeypatch.setattr(os, "replace", counted(os.replace))
    monkeypatch.setattr(Path, "unlink", counted(Path.unlink))


def test_a_kill_at_any_moment_of_a_save_loses_nothing(tmp_path):
    training = Training(tmp_path / "run", lanes_of(2))
    state, states = training.start(), {}
    for done in range(1, 9):
        state = training.step(state)
        states[done] = state
        if done in (6, 7):
            training.save(state, done)
    shutil.copytree(training.folder, tmp_path / "before")
    training.save(states[8], 8)
    after = {path.relative_to(training.folder) for path in training.folder.rglob("*")}
    ended = []
    while not ended or ended[-1] is Killed:
        shutil.rmtree(training.folder)
        shutil.copytree(tmp_path / "before", training.folder)
        with pytest.MonkeyPatch.context() as patch:
            killed_at(patch, len(ended))
            try:
                ended.append(training.save(states[8], 8))
            except Killed:
                ended.append(Killed)
        there = sorted(int(path.stem.split("_")[1]) for path in training.folder.glob("step_*.safetensors"))
        assert there in ([6, 7], [6, 7, 8], [7, 8])
        for done in there:
            assert_same(training.load(done), states[done])
        training.save(states[8], 8)  # the resumed training, when it is there again
        assert {path.relative_to(training.folder) for path in training.folder.rglob("*")} == after
    assert len(ended) > 15  # checkpoints, pieces written, and what is removed


@pytest.fixture
def two(tmp_path):
    """A training with checkpoints of 6 and 7 iterations."""
    training = Training(tmp_path / "run", lanes_of(1))
    state, states = training.start(), {}
    for done in range(1, 8):
        state = states[done] = training.step(state)
        if done > 5:
            training.save(state, done)
    return training, states


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda file: file.unlink(), r"cannot be read \(No such file or directory\)"),
        (lambda file: file.write_bytes(file.read_bytes()[:-1] + b"x"), "is not what was saved"),
        (lambda file: file.write_bytes(b""), "is not what was saved"),
    ],
)
def test_a_damaged_piece_is_named_and_the_older_checkpoint_taken_if_it_has_not_the_same(two, damage, words):
    training, states = two
    own = pieces._listed(training.path(7)) - pieces._listed(training.path(6))
    shared = pieces._listed(training.path(7)) & pieces._listed(training.path(6))
    for name, advice in (
        (min(own), "Remove it to continue from step_000000000006.safetensors."),
        (min(shared), "Restore it from a copy."),
    ):
        file = training.folder / "pieces" / name
        content = file.read_bytes()
        damage(file)
        with pytest.raises(UsageError, match=words) as error:
            training.load(7)
        assert str(file) in str(error.value) and str(error.value).endswith(advice) and "\n" not in str(error.value)
        if name in own:
            assert_same(training.load(6), states[6])
            saved = training.path(7).read_bytes()
            training.path(7).unlink()
            training.save(states[7], 7)  # the damaged piece is made anew if it is shorter or gone
            training.path(7).write_bytes(saved)
        file.write_bytes(content)
    assert_same(training.load(7), states[7])


def test_pieces_of_a_damaged_checkpoint_stay(two):
    training, states = two
    saved = training.path(6).read_bytes()
    training.path(6).write_bytes(saved[:100])
    (training.folder / "pieces" / "left").touch()
    pieces.prune(training.folder)
    training.path(6).write_bytes(saved)
    assert_same(training.load(6), states[6])
    pieces.prune(training.folder)
    assert not (training.folder / "pieces" / "left").exists()


def test_another_configuration_is_refused(two):
    training, _ = two
    like = jax.eval_shape(lambda: jax.tree.map(lambda x: x[None], fresh(0)))
    wide = ROW | {"obs": jnp.zeros(6)}
    replay = jax.eval_shape(lambda: jax.tree.map(lambda x: x[None], init_replay(wide, CAPACITY, CHUNK)))
    with pytest.raises(
        UsageError, match=r"fit this configuration: \.replay\.rows\['obs'\] has 480 bytes a seed, not 576"
    ):
        pieces.load(training.path(7), replace(like, replay=replay))
    both = jax.eval_shape(lambda: jax.tree.map(lambda x: jnp.stack([x, x]), fresh(0)))
    with pytest.raises(UsageError, match=r"does not fit this configuration: .* is "):
        pieces.load(training.path(7), both)
