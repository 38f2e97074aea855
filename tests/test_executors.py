"""Jobs without any learning, done by processes that are killed: nothing is lost, and nothing is done twice."""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
import submitit  # noqa: F401, as its logger keeps what is stderr when it is imported, which a test must not own
from commands import assistax
from pages import DOCS
from toy_jobs import LENGTH, jobs_of, steps_of

from assistax.cli.common import find_executor
from assistax.errors import UsageError
from assistax.executors import claims, drive, local, slurm
from assistax.executors.jobs import WORKER, Job, failure, status, work
from assistax.executors.local import Local
from assistax.executors.ray import Ray
from assistax.executors.slurm import Slurm
from assistax.teamwork import plan
from assistax.training import loop
from assistax.training.clock import progress_bar
from assistax.training.run import Run

TOYS = Path(__file__).with_name("toy_jobs.py")


@pytest.fixture
def toys(request, tmp_path, monkeypatch):
    """(folder, eight jobs or so many, command of a worker)."""
    monkeypatch.setattr(Local, "seconds", 0.05)
    monkeypatch.setattr(Slurm, "seconds", 0.05)
    count = getattr(request, "param", 8)
    return tmp_path, jobs_of(tmp_path, count), [sys.executable, str(TOYS), str(tmp_path), str(count)]


def finish(toys, using=None, workers=2):
    folder, jobs, command = toys
    return drive.drive(folder / "workers", jobs, using or Local(), command, workers, progress_bar)


def check_done_once(folder, count=8):
    """Each step of each job was done, in order, and no job was finished twice."""
    for i in range(count):
        assert [step for step, _ in steps_of(folder, f"{i:02d}")] == list(range(LENGTH))
    finished = (folder / "finished").read_text().split()
    assert len(finished) == len(set(finished))


def owners(folder):
    """Processes that have a job now."""
    newest = [paths[-1] for paths in claims.claims(folder / "workers").values()]
    return [claims.read(path)["pid"] for path in newest if claims.is_held(path)]


def wait_for(condition, seconds=20.0):
    until = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < until
        time.sleep(0.02)
    return found


@pytest.mark.parametrize("using", [Local(), Slurm(cluster="local")], ids=["local", "submitit"])
def test_workers_share_a_list_and_do_each_job_once(using, toys):
    assert finish(toys, using)
    check_done_once(toys[0])
    assert len({owner for i in range(8) for _, owner in steps_of(toys[0], f"{i:02d}")}) == 2
    before = claims.claims(toys[0] / "workers")
    assert finish(toys, using) and claims.claims(toys[0] / "workers") == before  # nobody is started for nothing


@pytest.mark.parametrize(("toys", "times"), [(16, 6), pytest.param(60, 20, marks=pytest.mark.slow)], indirect=["toys"])
def test_workers_are_killed(toys, times):
    """At random moments; what they were doing goes on from its last step."""
    folder, jobs, _ = toys
    chance, killed = random.Random(0), []

    def kill():
        while len(killed) < times and driving:
            time.sleep(chance.uniform(0.05, 0.3))
            if found := owners(folder):
                killed.append(chance.choice(found))
                with suppress(ProcessLookupError):
                    os.kill(killed[-1], signal.SIGKILL)

    driving = [True]
    thread = threading.Thread(target=kill)
    thread.start()
    try:
        assert finish(toys)
    finally:
        driving.clear()
        thread.join()
    assert len(killed) == times
    check_done_once(folder, len(jobs))


@pytest.mark.parametrize(("toys", "times"), [(8, 3), pytest.param(80, 20, marks=pytest.mark.slow)], indirect=["toys"])
def test_drivers_are_killed(toys, times):
    """Their workers save and end; whoever comes next goes on."""
    folder, jobs, command = toys
    chance = random.Random(1)
    for _ in range(times):
        driver = subprocess.Popen([*command, "local"], stderr=subprocess.DEVNULL)
        wait_for(lambda: len(owners(folder)) == 2)
        time.sleep(chance.uniform(0.0, 0.2))
        driver.kill()
        driver.wait()
    assert finish(toys)  # beside the workers of the last one, who have not noticed yet
    check_done_once(folder, len(jobs))


def test_one_that_is_preempted_saves_and_comes_back(toys):
    folder, _, _ = toys

    def preempt():
        """As Slurm does: a signal to submitit's process, whose child the worker is, and to the worker itself."""
        worker = wait_for(lambda: len(found := owners(folder)) == 2 and found[0])
        parent = int(Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[1])
        os.kill(worker, signal.SIGUSR2)
        os.kill(parent, signal.SIGUSR2)

    thread = threading.Thread(target=preempt)
    thread.start()
    assert finish(toys, Slurm(cluster="local"))
    thread.join()
    check_done_once(folder)
    released = [paths for paths in claims.claims(folder / "workers").values() if len(paths) > 1]
    assert released and all(claims.read(paths[0])["released"] for paths in released)
    assert "Caught signal SIGUSR2" in "".join(
        path.read_text() for path in (folder / "workers/logs/slurm").glob("*.err")
    )


def test_ctrl_c_has_the_workers_save(toys):
    folder, _, command = toys
    driver = subprocess.Popen([*command, "local"], stderr=subprocess.DEVNULL)
    wait_for(lambda: len(owners(folder)) == 2)
    driver.send_signal(signal.SIGINT)
    assert driver.wait(20) == 0 and not owners(folder)
    assert all(claims.read(paths[-1])["released"] for paths in claims.claims(folder / "workers").values())


@pytest.mark.parametrize("moment", ["claimed", "begun"])
def test_a_job_that_does_not_listen_yet_is_released(tmp_path, monkeypatch, moment):
    """SIGTERM comes between the claim and the moment from which the job itself would save."""

    def terminated(do):
        def then(*args):
            result = do(*args)
            os.kill(os.getpid(), signal.SIGTERM)
            return result

        return then

    before = signal.getsignal(signal.SIGTERM)
    if moment == "claimed":
        monkeypatch.setattr("assistax.executors.jobs.take", terminated(claims.take))
    job = Job("one", 1, lambda: 0, terminated(lambda: True))
    with pytest.raises(KeyboardInterrupt):
        work(tmp_path, [job])
    assert claims.read(tmp_path / "one.0001")["released"] and signal.getsignal(signal.SIGTERM) is before


def test_a_job_that_cannot_be_done_is_given_up_after_all_others(toys):
    folder, jobs, _ = toys
    (folder / "00.bad").touch()
    with pytest.raises(UsageError, match=r"^1 of 8 jobs failed, 00 for one: A toy that cannot be\. What is finished"):
        finish(toys)
    assert all(job.finished for job in jobs[1:])
    (folder / "00.bad").unlink()
    assert finish(toys)
    check_done_once(folder)


def test_workers_that_cannot_begin_say_why(toys):
    folder, jobs, _ = toys
    with pytest.raises(UsageError, match="end before they begin a job: no such toy"):
        finish((folder, jobs, [sys.executable, "-c", "import sys; sys.exit('no such toy')"]))


def test_a_claim_is_held_until_its_owner_is_gone(tmp_path, monkeypatch):
    job = Job("a", 1, lambda: 0, lambda: True)
    mine = claims.take(tmp_path, "a", [], 0)
    assert mine and claims.take(tmp_path, "a", [], 0) is None
    (held,) = claims.claims(tmp_path)["a"]
    assert claims.take(tmp_path, "a", [held], 0) is None
    assert (status(tmp_path, [job]).held, status(tmp_path, [job]).here) == (1, 1)
    mine.release()
    assert status(tmp_path, [job]).open == (job,)
    # on another machine only time tells
    about = json.loads(held.read_text()) | {"machine": "another", "released": False}
    held.write_text(json.dumps(about))
    assert claims.is_held(held)
    assert (status(tmp_path, [job]).held, status(tmp_path, [job]).here) == (1, 0)  # no worker of this machine's driver
    long_ago = time.time() - claims.LOST - 1
    os.utime(held, (long_ago, long_ago))
    assert not claims.is_held(held)
    held.write_text("")  # cut short by a crash: as if it were of another machine
    assert claims.is_held(held)


def test_an_owner_that_was_given_up_ends_when_it_wakes(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from assistax.executors import claims; claims.BEAT = 0.05\n"
        "mine = claims.take(Path(sys.argv[1]), 'a', [], 0); time.sleep(20)"
    )
    owner = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stderr=subprocess.PIPE, text=True)
    wait_for(lambda: claims.claims(tmp_path))
    (tmp_path / "a.0002").write_text("{}")
    assert owner.communicate(timeout=10)[1].startswith("a was given to another process") and owner.returncode == 1


def test_a_job_is_begun_three_times_where_it_stands(tmp_path):
    paths = [tmp_path / f"a.{i:04d}" for i in (1, 2, 3)]
    for path in paths:
        path.write_text(json.dumps({"at": 5}))
    assert failure(paths[:2], lambda: 5) is None and failure(paths, lambda: 6) is None
    assert failure(paths, lambda: 5) == "it has ended 3 times without getting further"
    paths[1].write_text(json.dumps({"at": 5, "released": True}))
    assert failure(paths, lambda: 5) is None


def test_a_full_disk_ends_in_a_line(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(claims.os, "link", full)
    with pytest.raises(UsageError, match=r"^Cannot write .*: No space left on device\.$"):
        work(tmp_path / "workers", [Job("a", 1, lambda: 0, lambda: True)])
    assert not list((tmp_path / "workers").iterdir())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--executor", "cloud"), "Unknown executor 'cloud'. Known: local, slurm, ray."),
        (("--executor-set", "corse=2"), "Unknown setting 'corse'. Did you mean 'cores'? Known: cores."),
        (("--executor-set", "cores"), "--executor-set takes NAME=VALUE, for example cores=4, not 'cores'."),
        (("--executor-set", "cores=1000"), "those of this machine, not 1000."),
        (("--processes", "1000"), "the cores of this machine, not 1000."),
        (("--processes", "0"), "the cores of this machine, not 0."),
        (("--processes", "2", "--shard", "1/2"), "Processes share the work among themselves; leave out --shard."),
        (("--executor", "slurm"), "Slurm is not on this machine: there is no command sinfo."),
        (("--executor", "slurm", "--executor-set", "hours=0"), "cores must be 1 or more and hours 0.07 to 8760."),
        (("--executor", "slurm", "--executor-set", "memory_gb=-3"), "memory_gb must be 0 (as the partition says) or"),
        (("--executor", "slurm", "--executor-set", "options=qos"), "options takes NAME=VALUE,NAME=VALUE, for example"),
        (("--executor", "slurm", "--executor-set", "options=signal=9"), "options cannot have signal, which tells"),
        (("--executor", ""), "Unknown executor ''. Known: local, slurm, ray."),
        (("--executor", "ray"), 'The executor ray needs an extra: pip install "assistax[ray]".'),
    ],
)
def test_what_cannot_be_is_said_in_a_line(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setattr(slurm.shutil, "which", lambda _: None)
    with pytest.raises(SystemExit):
        assistax("population", "train", "scratch", "--out", tmp_path / "pop", *words)
    printed = capsys.readouterr().err.strip()
    assert printed.startswith("assistax: ") and said in printed and "\n" not in printed
    assert not list(tmp_path.iterdir())


def test_slurm_knows_its_partitions(monkeypatch):
    monkeypatch.setattr(slurm, "_ask", lambda *_: "main 2\nbig 64+\n")
    assert Slurm("big", cores=64).room(None, 100) == slurm.MANY and Slurm("main").room(None, 3) == 3
    with pytest.raises(UsageError, match=r"Unknown partition 'mian'\. Did you mean 'main'"):
        Slurm("mian").room(None, 1)
    with pytest.raises(UsageError, match="cores must be 1 to 2, those of a node, not 3"):
        Slurm("main", cores=3).room(None, 1)
    assert Slurm("main,big", cores=64).room(None, 3) == 3


def test_without_a_wish_processes_share_the_cores_but_on_an_accelerator_and_within_each_other(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(2))
    assert isinstance(find_executor(None, None, ()), Local)
    assert isinstance(find_executor(1, "local", ()), Local)
    assert find_executor(1, None, ()) is find_executor(None, None, (), here=True) is None
    monkeypatch.setattr("jax.default_backend", lambda: "gpu")
    assert find_executor(None, None, ()) is None
    monkeypatch.setattr("jax.default_backend", lambda: "cpu")
    monkeypatch.setenv(WORKER, "1")
    assert find_executor(None, None, ()) is None
    monkeypatch.delenv(WORKER)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(1))
    assert find_executor(None, None, ()) is None


def test_without_a_wish_there_are_no_more_processes_than_memory_for_them(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)))
    monkeypatch.setattr(local, "memory_gb", lambda: 17.0)
    assert Local().room(None, 100) == 8
    assert Local().room(None, 3) == 3
    assert Local().room(64, 100) == 64


def test_submitit_on_this_machine_has_no_more_workers_than_cores_unless_told():
    assert Slurm(cluster="local").room(None, 10**6) == os.cpu_count()
    assert Slurm(cluster="local", cores=10**6).room(None, 8) == 1
    assert Slurm(cluster="local").room(3, 8) == 3


def test_the_commands_of_the_page_are_commands(tmp_path, monkeypatch):
    page = (DOCS / "clusters.md").read_text()
    blocks = "\n".join(re.findall(r"^```sh\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)).replace("\\\n", " ")
    commands = [line.split() for line in blocks.splitlines() if line.startswith("assistax ")]
    trained = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(64))
    for kind in (Slurm, Ray):
        monkeypatch.setattr(kind, "room", lambda *_: 1)
    monkeypatch.setattr(plan, "train", lambda *args: trained.append(args))
    monkeypatch.setattr(plan, "train_with", lambda *args: trained.append(args))
    monkeypatch.setattr("jax.local_device_count", lambda: 4)
    summary = {"mean_return": 0.0, "success_rate": 0.0, "env_steps_per_s": 1}
    monkeypatch.setattr(loop, "train", lambda run, **_: trained.append((run, run)) or summary)
    for command in commands:
        assistax(*command[1:])
        shutil.rmtree("populations", ignore_errors=True)
    assert len(trained) == len(commands) == 8
    assert {type(args[1]) for args in trained} == {Local, Slurm, Ray, Run}
