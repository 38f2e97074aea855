"""Files that are damaged, of earlier versions or cannot be written: one line that names them."""

import errno
import json
import os
import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from stored import small, store_checkpoint, stored_run
from test_results import write_run

from assistax import cli
from assistax.errors import UsageError
from assistax.evaluation import film
from assistax.evaluation.filmed import Filmed
from assistax.files import mismatch, read_json, read_rows, write_atomically, writing
from assistax.results.stored import find_runs
from assistax.training.checkpoint import EVERYTHING, content_hash, load_checkpoint, read_metadata, save_checkpoint
from assistax.training.configuration import configure, read_config
from assistax.training.loop import train
from assistax.training.run import Run

# -- JSON --------------------------------------------------------------------------------------

SCHEMA = {"name": str, "sizes?": [range(1, 10)], "mean": (float, None), "people?": (str, [{str: str}]), "on?": bool}


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"name": "a", "mean": 1}, None),
        ({"name": "a", "mean": None, "sizes": [], "on": True, "people": "all", "more": [None]}, None),
        ({"name": "a", "mean": 0.5, "sizes": [1, 9], "people": [{}, {"b": "c"}]}, None),
        ([], "it must be an object, not []"),
        ({"mean": 1}, "it has no name"),
        ({"name": "a", "mean": True}, "mean must be a finite number or null, not True"),
        ({"name": "a", "mean": float("nan")}, "mean must be a finite number or null, not nan"),
        ({"name": "a", "mean": 1, "sizes": [3, 10]}, "sizes[1] must be a whole number from 1 to 9, not 10"),
        ({"name": "a", "mean": 1, "sizes": [3.0]}, "sizes[0] must be a whole number from 1 to 9, not 3.0"),
        ({"name": "a", "mean": 1, "sizes": None}, "sizes must be a list, not None"),
        ({"name": "a", "mean": 1, "on": 1}, "on must be true or false, not 1"),
        ({"name": "a", "mean": 1, "people": [{"b": 3}]}, "people[0].b must be text, not 3"),
        ({"name": "a", "mean": 1, "people": 3}, "people must be text or a list, not 3"),
    ],
)
def test_a_schema(value, words):
    assert mismatch(value, SCHEMA) == words


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff\xfe", "it is not UTF-8 text"),
        (b"{", "it is not JSON"),
        (b"[" * 100_000, "it is nested too deeply"),
        (b"9" * 20, "the number 999999999999999999... is too long"),
        (b"9" * 5000, "is too long"),
        (b"null", "it must be an object, not None"),
        (b'{"a": 1e999}', "a must be a finite number, not inf"),
        (b'{"a": NaN}', "a must be a finite number, not nan"),
    ],
)
def test_json_that_cannot_be_used(tmp_path, content, words):
    path = tmp_path / "file.json"
    path.write_bytes(content)
    with pytest.raises(UsageError) as error:
        read_json(path, {"a": float})
    assert str(error.value).startswith(f"Cannot read {path}: ") and words in str(error.value)
    assert "\n" not in str(error.value) and len(str(error.value)) < 300


def test_rows(tmp_path):
    path = tmp_path / "rows.jsonl"
    assert read_rows(path, {"a": float}) == []
    path.write_bytes(b'{"a": 1}\n{"a": 2}\n{"a"')
    assert read_rows(path, {"a": float}) == [{"a": 1}, {"a": 2}]
    for content, words in ((b'{"a": 1}\n5\n', "line 2 of 2"), (b'{\n{"a": 1}\n', "line 1 of 2")):
        path.write_bytes(content)
        with pytest.raises(UsageError, match=words):
            read_rows(path, {"a": float})


def test_a_folder_in_the_place_of_a_file(tmp_path):
    (tmp_path / "config.json").mkdir()
    for read in (lambda: read_config(tmp_path), lambda: Run.open(tmp_path), lambda: find_runs([tmp_path])):
        with pytest.raises(UsageError, match=r"Cannot read .*config\.json: Is a directory"):
            read()


# -- checkpoints -------------------------------------------------------------------------------


def tree():
    rng = np.random.default_rng(0)
    weights = {"w": rng.normal(size=(3, 2)).astype(np.float32), "half": rng.normal(size=4).astype(np.float16)}
    return weights | {"n": np.int32(7), "on": np.array([True, False]), "none": np.zeros((0, 3), np.float32)}


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "tree.safetensors"
    save_checkpoint(path, tree(), {"what": "a tree"})
    return path


def without_checksums(path, **changes):
    """As earlier versions wrote them."""
    with safe_open(path, "numpy") as file:
        header = file.metadata()
    del header["sha256"]
    save_file(load_file(path) | changes, path, header)


def test_any_flipped_bit_is_found(saved):
    content, loaded = saved.read_bytes(), load_checkpoint(saved, tree())
    found, positions = 0, range(0, 8 * len(content), 13)
    for bit in positions:
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << bit % 8
        saved.write_bytes(flipped)
        try:
            again, about = load_checkpoint(saved, tree()), read_metadata(saved)
        except UsageError as error:
            assert saved.name in str(error) and "\n" not in str(error)
            found += 1
        else:  # in what does not count, as the space that pads the header
            jax.tree.map(np.testing.assert_array_equal, again, loaded)
            assert about == {"what": "a tree"}
    assert found > 0.9 * len(positions)


def test_relabelled_types_are_found(saved):
    content = saved.read_bytes()
    assert b'"dtype":"F32","shape":[3,2]' in content
    for dtype in (b"I32", b"U32"):
        saved.write_bytes(content.replace(b'"dtype":"F32","shape":[3,2]', b'"dtype":"%s","shape":[3,2]' % dtype))
        with pytest.raises(UsageError, match=r"tree\.safetensors is damaged: \['w'\] is not what was saved"):
            load_checkpoint(saved, tree())
    saved.write_bytes(content.replace(b'"shape":[3,2]', b'"shape":[2,3]'))
    with pytest.raises(UsageError, match="is damaged"):
        load_checkpoint(saved, tree() | {"w": np.zeros((2, 3), np.float32)})


def test_a_checkpoint_of_an_earlier_version(saved):
    before = content_hash(saved)
    without_checksums(saved)
    jax.tree.map(np.testing.assert_array_equal, load_checkpoint(saved, tree()), jax.tree.map(jnp.asarray, tree()))
    assert content_hash(saved) != before
    without = load_file(saved)
    save_file(
        without | {"['w']": without["['w']"].view(np.int32)}, saved, {"format": "assistax-checkpoint-1", "about": "{}"}
    )
    with pytest.raises(UsageError, match=r"\['w'\] is int32, not float32"):
        load_checkpoint(saved, tree())


def test_weights_that_are_not_finite(saved):
    save_checkpoint(saved, tree() | {"w": np.full((3, 2), np.inf, np.float32)}, {})
    assert np.isinf(load_checkpoint(saved, tree())["w"]).all()  # a state may be
    with pytest.raises(UsageError, match=r"\['w'\] has numbers that are not finite"):
        load_checkpoint(saved, tree(), finite=EVERYTHING)


def test_the_content_hash_is_of_names_types_and_metadata(saved, tmp_path):
    before, other = content_hash(saved), tmp_path / "other"
    assert before == save_checkpoint(other, tree(), {"what": "a tree"}) == content_hash(other)
    n = tree()
    for content, about in (
        (n, {"what": "another"}),
        (n | {"n": np.int32(8)}, {"what": "a tree"}),
        (n | {"n": np.uint32(7)}, {"what": "a tree"}),
        ({name + "x": array for name, array in n.items()}, {"what": "a tree"}),
    ):
        assert save_checkpoint(other, content, about) != before


def test_the_older_checkpoint_is_named(tmp_path):
    run = stored_run(tmp_path / "run", small())
    newest = store_checkpoint(run, 128)
    content = bytearray(newest.read_bytes())
    for bad, words in ((content[:-1] + b"\x01", "is not what was saved"), (content[:100], "not a safetensors file")):
        newest.write_bytes(bad)
        for use in (Run.open(run.folder).teams, partial(train, Run.open(run.folder))):
            with pytest.raises(UsageError, match=words) as error:
                use()
            assert str(newest) in str(error.value)
            assert str(error.value).endswith("Remove it to continue from step_000000000064.safetensors.")
    newest.unlink()
    assert Run.open(run.folder).teams()


# -- writing -----------------------------------------------------------------------------------


@pytest.fixture
def refused(monkeypatch, capsys):
    """Call the command line; the one line that it answers."""

    def call(*args):
        monkeypatch.setattr(sys, "argv", ["assistax", *map(str, args)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        lines = capsys.readouterr().err.strip().splitlines()
        assert end.value.code == 2 and lines[-1].startswith("assistax: ")
        return lines[-1]

    return call


def no_space(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def full_disk(monkeypatch):
    monkeypatch.setattr(os, "fsync", no_space)


FULL = "No space left on device"


def test_a_full_disk_keeps_the_old_file(tmp_path, full_disk):
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with pytest.raises(UsageError, match=f"Cannot write {path}: {FULL}"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_an_error_of_several_lines_is_cut(tmp_path):
    with pytest.raises(UsageError) as error, writing(tmp_path):
        raise OSError("broken pipe\n\nCOMMAND")
    assert str(error.value) == f"Cannot write {tmp_path}: broken pipe."


def test_a_full_disk_is_one_line(tmp_path, refused, monkeypatch):
    run, made = stored_run(tmp_path / "run", small()), write_run(tmp_path / "made", [1, 2])
    with monkeypatch.context() as patch:
        patch.setattr("assistax.training.loop.train", no_space)  # as when rows are written
        assert f"Cannot write {run.folder}: {FULL}" in refused("train", "--resume", run.folder)
    monkeypatch.setattr(os, "fsync", no_space)
    assert FULL in refused("train", "scratch", "--out", tmp_path / "new")
    for command in ("export", "plot"):
        out = tmp_path / {"export": "out.safetensors", "plot": "out.svg"}[command]
        folder = run.folder if command == "export" else made
        assert f"Cannot write {out}: {FULL}" in refused(command, folder, "--out", out)
        assert not out.exists()


@pytest.mark.parametrize("name", ["a.png", "a.webp", "a.mp4"])
def test_a_film_is_written_whole_or_not_at_all(tmp_path, monkeypatch, name):
    class Camera:
        def __init__(self, *_, **__): ...
        def __enter__(self):
            return self

        def __exit__(self, *_): ...
        def picture(self, qpos, marker):
            return np.zeros((64, 64, 3), np.uint8)

    monkeypatch.setattr(film, "Camera", Camera)
    path, still = tmp_path / name, np.zeros((10, 3))
    filmed = Filmed("scratch", 0.04, still, still)
    film.film(filmed, path, view="main")
    before = path.read_bytes()
    assert len(before) > 50
    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(UsageError, match=f"Cannot write {path}: {FULL}"):
        film.film(filmed, path, view="main")
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
    with pytest.raises(UsageError, match="Cannot write"):
        film.film(filmed, tmp_path / name / name, view="main")


# -- sizes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"num_envs": 10**13}, "num_envs must be below 2^31"),
        ({"num_envs": 2**26}, "num_envs x ppo.num_steps must be below 2^31"),
        ({"seed": 12345678901234567890}, "seed must be from 0 to 2^32 - 1"),
        ({"seed": -1}, "seed must be from 0 to 2^32 - 1"),
        ({"seed": 2**32 - 1, "num_seeds": 2}, "seed must be from 0 to 2^32 - 1"),
    ],
)
def test_sizes_beyond_what_can_be_counted(choices, words):
    with pytest.raises(UsageError) as error:
        configure("scratch", {}, **choices)
    assert words in str(error.value)
    assert configure("scratch", {}, seed=2**32 - 1).seed == 2**32 - 1


@pytest.mark.parametrize(
    ("algorithm", "settings", "words"),
    [
        ("masac", {"sac.buffer_size": 10**13}, "sac.buffer_size must be below 2^31"),
        ("masac", {"sac.updates": 10**13}, "sac.updates must be below 2^31"),
        ("masac", {"sac.warmup": 10**13}, "sac.warmup must be 0 or more and below 2^31"),
        ("masac", {"sac.batch_size": 2**31 - 1}, "sac.batch_size must be at most 16777216"),
        ("masac", {"sac.hidden": (10**13,)}, "sac.hidden must be"),
        ("ippo", {"ppo.hidden": (10**13, 8)}, "ppo.hidden must be"),
        ("ippo", {"ppo.update_epochs": 10**13}, "ppo.update_epochs must be below 2^31"),
        ("ippo", {"env.episode_length": 10**13}, "env.episode_length must be below 2^31"),
        ("ippo", {"env.num_threads": 10**9}, "env.num_threads must be from 0 (all cores) to 65536"),
    ],
)
def test_settings_beyond_what_can_be_counted(algorithm, settings, words):
    with pytest.raises(UsageError) as error:
        configure("scratch", settings, algorithm=algorithm)
    assert words in str(error.value)


def test_what_memory_cannot_hold_is_refused_before_there_is_a_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("assistax.training.memory.memory_gb", lambda: 900.0)
    for config, part in (
        (configure("scratch", {"sac.buffer_size": 2**31 - 1}, algorithm="masac"), "replay"),
        (configure("scratch", {}, algorithm="masac", num_seeds=9000), "replay"),
        (configure("scratch", {"ppo.num_steps": 3 * 2**21}), "the steps of an iteration"),
    ):
        with pytest.raises(UsageError, match=rf"would take [\d,]+ GB .* for {part}, and there are 900 GB"):
            Run.create(config, tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_too_little_memory_is_one_line(refused, monkeypatch):
    def train(**_):
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 1280000000 bytes.")

    monkeypatch.setattr(cli, "COMMANDS", (train, cli.sweep))
    assert "too little memory" in refused("train")


def test_seeds_of_commands(refused):
    for command in (
        ["humans"],
        ["evaluate", "scratch", "--policy", "still"],
        ["render", "scratch", "--policy", "still"],
    ):
        assert "seed must be from 0" in refused(*command, "--seed", 10**20)


def test_stored_configurations_name_their_file(tmp_path):
    folder = write_run(tmp_path / "run", [1, 2])
    path = folder / "config.json"
    stored = json.loads(path.read_text())
    path.write_text(json.dumps(stored | {"ppo": {"gama": 1}}))
    with pytest.raises(UsageError, match=r"Cannot read .*config\.json: Unknown setting 'ppo.gama'"):
        read_config(folder)
