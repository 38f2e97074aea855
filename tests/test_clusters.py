"""Jobs on real clusters: Ray with two nodes of which one is lost, and Slurm with one.

Slurm runs where ASSISTAX_TEST_SLURM is set: tests/slurm/one_node.sh installs and starts it, which needs root.
"""

import os
import subprocess
import sys
import threading
import time

import pytest
from test_executors import TOYS, check_done_once, owners, toys, wait_for

from assistax.errors import UsageError
from assistax.executors import claims
from assistax.executors.drive import drive
from assistax.executors.ray import Ray
from assistax.executors.slurm import Slurm
from assistax.training.clock import progress_bar

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("clusters"), pytest.mark.filterwarnings("ignore")]
needs_slurm = pytest.mark.skipif("ASSISTAX_TEST_SLURM" not in os.environ, reason="see tests/slurm/one_node.sh")
__all__ = ["toys"]


def finish(toys, using, workers=2):
    folder, jobs, command = toys
    return drive(folder / "workers", jobs, using, command, workers, progress_bar)


def beside(function):
    """Runs while the jobs are done."""
    thread = threading.Thread(target=function)
    thread.start()
    return thread


@pytest.fixture
def two_nodes():
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    about = {"num_cpus": 1, "object_store_memory": 100 * 2**20}
    cluster = Cluster(initialize_head=True, head_node_args=about | {"include_dashboard": False})
    second = cluster.add_node(**about)
    yield cluster, second, about
    ray.shutdown()
    cluster.shutdown()


def test_no_ray_at_an_address_is_a_line():
    pytest.importorskip("ray")
    with pytest.raises(UsageError, match=r"Ray cannot be reached at 127\.0\.0\.1:1: ") as error:
        Ray(address="127.0.0.1:1").room(None, 8)
    assert "\n" not in str(error.value)


def test_ray_loses_a_node(toys, two_nodes, monkeypatch):
    folder, _, _ = toys
    cluster, second, about = two_nodes
    using = Ray(address=cluster.address)
    with pytest.raises(UsageError, match="cores must be 1 to 1"):
        Ray(address=cluster.address, cores=2).room(None, 8)
    with pytest.raises(UsageError, match="--processes must be 1 to 2, the cores of the cluster, not 3"):
        using.room(3, 8)

    def lose():
        wait_for(lambda: len(owners(folder)) == 2, 60)
        cluster.remove_node(second, allow_graceful=False)
        time.sleep(1.0)
        cluster.add_node(**about)

    losing = beside(lose)
    assert finish(toys, using)
    losing.join()
    check_done_once(folder)
    assert any(len(paths) > 1 for paths in claims.claims(folder / "workers").values())


@needs_slurm
def test_slurm_does_an_array(toys):
    assert finish(toys, Slurm(partition="main", hours=0.1))
    check_done_once(toys[0])
    scripts = list((toys[0] / "workers/logs/slurm").glob("*submission.sh"))
    assert any("--array=0-1" in script.read_text() for script in scripts)


def first_running():
    """Slurm's id of a running job of ours."""
    words = ["squeue", "--me", "--noheader", "--array", "--states=R", "--format=%i"]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()[0]


@needs_slurm
def test_slurm_requeues_what_it_preempts(toys):
    folder, _, _ = toys

    def preempt():
        wait_for(lambda: len(owners(folder)) == 2, 60)
        job = first_running()
        for signal in ("TERM", "USR2"):
            subprocess.run(["scancel", "--signal", signal, job], check=True)

    preempting = beside(preempt)
    assert finish(toys, Slurm(hours=0.1))
    preempting.join()
    check_done_once(folder)
    assert "Requeued job" in "".join(path.read_text() for path in (folder / "workers/logs/slurm").glob("*.out"))


@needs_slurm
def test_slurm_cancels_or_kills_a_job_in_the_middle(toys):
    folder, _, _ = toys

    def cancel():
        for words in (["scancel"], ["scancel", "--signal", "KILL"]):
            wait_for(lambda: len(owners(folder)) == 2, 60)
            subprocess.run([*words, first_running()], check=True)
            time.sleep(0.5)

    cancelling = beside(cancel)
    assert finish(toys, Slurm(hours=0.1))
    cancelling.join()
    check_done_once(folder)


@needs_slurm
def test_slurm_goes_on_without_its_driver(toys):
    """And the next driver does not start others beside its workers."""
    folder, jobs, _ = toys
    driver = subprocess.Popen([sys.executable, str(TOYS), str(folder), "8", "slurm"], stderr=subprocess.DEVNULL)
    wait_for(lambda: len(owners(folder)) == 2, 60)
    driver.kill()
    driver.wait()
    wait_for(lambda: all(job.finished for job in jobs), 60)
    assert finish(toys, Slurm())
    check_done_once(folder)


@needs_slurm
def test_slurm_says_what_it_does_not_have(toys):
    for using, said in (
        (Slurm("mian"), "Unknown partition 'mian'. Did you mean 'main'"),
        (Slurm(cores=1000), "those of a node, not 1000"),
        (Slurm(options="nodelist=nowhere"), "Slurm does not take the job"),
    ):
        with pytest.raises(UsageError, match=said):
            finish(toys, using)
