"""Ctrl-C in the first seconds of `assistax train`: one line, and no folder in which there is nothing."""

import os
import signal
import subprocess
import sys

import pytest
from stored import SMALL

import assistax.training.loop
import assistax.training.run
from assistax import __main__

# The command in a process that interrupts itself when it comes to load a module.
LOADING = """
import os, signal, sys
from assistax.__main__ import main

signal.signal(signal.SIGINT, signal.default_int_handler)

def watch(event, args):
    if event == "import" and args[0] == module:
        os.kill(os.getpid(), signal.SIGINT)

module, sys.argv[1:] = sys.argv[1], ["train", "scratch"]
sys.addaudithook(watch)
main()
"""


@pytest.mark.parametrize("module", ["tyro", "jax"])
def test_while_it_loads(module, tmp_path):
    command = [sys.executable, "-c", LOADING, module]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "assistax: stopped.\n")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def ctrl_c():
    """As in a terminal, also where tests run in the background and their processes are to ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt(*_, **__):
    os.kill(os.getpid(), signal.SIGINT)
    raise AssertionError("goes on")


@pytest.mark.parametrize(
    ("place", "name"),
    [
        (assistax.training.run, "keep_partners"),  # the folder is there, and nothing in it
        (assistax.training.run.Run, "write_config"),
        (assistax.training.loop, "_Training"),
    ],
)
def test_before_anything_is_trained(place, name, ctrl_c, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(place, name, interrupt)
    settings = [f"{name}={value}" for name, value in SMALL.items()]
    monkeypatch.setattr(
        sys, "argv", ["assistax", "train", "scratch", "--out", str(tmp_path / "run"), "--set", *settings]
    )
    with pytest.raises(SystemExit) as end:
        __main__.main()
    assert end.value.code == 130 and capsys.readouterr().err.splitlines()[-1] == "assistax: stopped."
    assert not list(tmp_path.iterdir())
