"""Every file that the program takes in, mutated at random: it is read, or refused in one line that names it."""

import copy
import json
import shutil

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from stored import small, store_checkpoint, stored_run, stored_team
from test_results import RECORDS, write_run

from assistax.errors import UsageError
from assistax.files import read_json
from assistax.formats import PARTNER, TRIAL, UNFINISHED
from assistax.human.population import people
from assistax.results.comparison import read_references, report, tables
from assistax.results.stored import StoredRun, curve, experiments, find_runs
from assistax.training import pieces
from assistax.training.checkpoint import EVERYTHING, content_hash, load_checkpoint, read_metadata, save_checkpoint
from assistax.training.configuration import read_config, trained_env
from assistax.training.run import Run
from assistax.training.run_folder import check_checkpoint
from assistax.training.sweep import Sweep, rank, read_sweep
from assistax.training.team_file import params_like, read_team

TRIAL_ROW = {"config": 0, "seed": 0, "settings": {"ppo.gamma": 0.97}, "steps": 64, "seconds": 0.1, "curve": [[64, 1.0]]}
TRIAL_ROW |= {"auc": 1.0, "final_return": 1.0, "success": None, "failed": False}


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
    """By file how it is read, as far as that takes neither an environment nor a compilation."""
    place = tmp_path_factory.mktemp("files")
    finished = write_run(place / "finished", [[1.0, 2.0], [3.0, 4.0]])
    team = stored_team(place / "team.safetensors", small())
    run = stored_run(place / "run", small(partners=(f"human={team}",)))
    saved = store_checkpoint(Run.open(run.folder), 64)
    copied = run.folder / "partners" / "human.safetensors"
    sweep = Sweep.create(small(), place / "sweep", 2, {"ppo.gamma": "0.9:0.99"}).folder
    trial = sweep / "trial.json"
    trial.write_text(json.dumps(TRIAL_ROW))
    unfinished = sweep / "unfinished.safetensors"
    save_checkpoint(unfinished, {}, {"trials": [[0, 0]], "points": [[[1.0, 1, 1.0]]], "seconds": {"training": 1.0}})
    state = {"ring": np.arange(64, dtype=np.float32).reshape(1, 64), "n": np.zeros(1, np.int32)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pieces, "PIECE", 64)
        pieces.save(place / "step_1.safetensors", state, {})
    (place / "experts.json").write_text(json.dumps(RECORDS))
    (place / "people.json").write_text('[{"disability": "tremor", "preference": "default"}]')
    like = params_like(trained_env(small())[1])
    whole = jax.eval_shape(run.trainer.init, jax.random.key(0))
    parts = {
        name: jax.tree.map(lambda x: jax.ShapeDtypeStruct((1, *x.shape), x.dtype), getattr(whole, name))
        for name in ("params", "normalizer")
    }

    def tabulate(path):
        found = experiments(find_runs([finished]))
        tables(report(found, read_references(place / "experts.json"), compare=True))

    def plot(path):
        curve(experiments([StoredRun.read(finished)])[0], "return", "evaluation")
        curve(experiments([StoredRun.read(finished)])[0], "return", "training")

    def checkpoint(path):
        check_checkpoint(path, run.config)
        for name, part in parts.items():
            load_checkpoint(path, part, f".{name}")

    def play(path):
        read_team(path)
        load_checkpoint(path, like, finite=EVERYTHING)

    def partner(path):
        read_metadata(path, PARTNER)
        content_hash(path)

    return {
        finished / "config.json": tabulate,
        run.folder / "config.json": lambda path: read_config(path.parent),
        finished / "summary.json": tabulate,
        finished / "evaluations.jsonl": plot,
        finished / "metrics.jsonl": plot,
        place / "experts.json": tabulate,
        place / "people.json": people,
        sweep / "sweep.json": lambda path: read_sweep(path.parent),
        trial: lambda path: rank([read_json(path, TRIAL)]),
        place / "step_1.safetensors": lambda path: pieces.load(path, state),
        unfinished: lambda path: read_metadata(path, UNFINISHED),
        saved: checkpoint,
        team: play,
        copied: partner,
    }


VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([10**13, 10**20, -1, 0]),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from([[], {}, [[]], [0.5], {"a": 1}, [{"disability": 3}], "feeding", "mappo", "1e999"]),
)


def mutated_json(data, value):
    """`value` with one part, however deep, replaced, removed or renamed."""
    if not isinstance(value, (dict, list)) or not value or not data.draw(st.integers(0, 9)):
        return data.draw(VALUES)
    value = copy.copy(value)
    key = data.draw(st.sampled_from(list(value) if isinstance(value, dict) else range(len(value))))
    change = data.draw(st.sampled_from(["replace", "replace", "replace", "remove", "rename"]))
    if change == "replace":
        value[key] = mutated_json(data, value[key])
        return value
    part = value.pop(key)
    if change == "rename" and isinstance(value, dict):
        value[data.draw(st.text(max_size=5))] = part
    return value


def mutated_bytes(data, content):
    content = bytearray(content)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, max(0, len(content) - 1)))
        change = data.draw(st.sampled_from(["flip", "cut", "insert", "remove", "repeat"]))
        if change == "flip" and content:
            content[at] ^= 1 << data.draw(st.integers(0, 7))
        elif change == "cut":
            del content[at:]
        elif change == "insert":
            content[at:at] = data.draw(st.binary(max_size=8))
        elif change == "remove":
            del content[at : at + data.draw(st.integers(1, 8))]
        else:
            content[at:at] = content[at : at + data.draw(st.integers(1, 200))]
    return bytes(content)


def mutated_checkpoint(data, path):
    """Metadata or the type of an array changed, with checksums that fit or, as in earlier versions, none."""
    arrays = load_file(path)
    with safe_open(path, "numpy") as file:
        header = file.metadata()
    if data.draw(st.booleans()):
        header["about"] = json.dumps(mutated_json(data, json.loads(header["about"])))
    elif arrays:
        name = data.draw(st.sampled_from(sorted(arrays)))
        arrays[name] = arrays[name].view(data.draw(st.sampled_from(["int32", "uint32"])))
    if data.draw(st.booleans()):
        del header["sha256"]
    save_file(arrays, path, header)


@pytest.mark.filterwarnings("ignore")  # sums of huge numbers
@settings(max_examples=300, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_mutated_file_is_read_or_refused_in_one_line(readers, data):
    path = data.draw(st.sampled_from(list(readers)))
    before = path.read_bytes()
    try:
        kind = data.draw(st.sampled_from(["bytes", "parts", "parts", "parts", "folder"]))
        if kind == "folder":
            path.unlink()
            if data.draw(st.booleans()):
                path.mkdir()
        elif kind == "bytes":
            path.write_bytes(mutated_bytes(data, before))
        elif path.suffix == ".safetensors":
            mutated_checkpoint(data, path)
        elif path.suffix == ".jsonl":
            rows = [json.loads(line) for line in before.splitlines()]
            changed = data.draw(st.integers(0, len(rows) - 1))
            rows[changed] = mutated_json(data, rows[changed])
            path.write_text("".join(json.dumps(row) + "\n" for row in rows))
        else:
            path.write_text(json.dumps(mutated_json(data, json.loads(before))))
        readers[path](path)
    except UsageError as error:
        assert "\n" not in str(error)
    finally:
        if path.is_dir():
            shutil.rmtree(path)
        path.write_bytes(before)
