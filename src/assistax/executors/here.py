"""Doing a list of jobs in this process, with one progress bar over all of them."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

from tqdm import tqdm

from assistax.executors.jobs import Job, work


def work_here(
    folder: Path,
    jobs: Callable[[Callable], list[Job]],
    bar: Callable[[int, int], tqdm],
    what: str,
    shard: tuple[int, int] = (1, 1),
) -> bool:
    """`work` on shard i of n (1 to n) of the jobs that `jobs`, given a maker of their progress bars, makes.

    `bar` makes the bar over all, of the total and what is done; it says which job it is at, each called `what`.
    """
    mine: list[Job] = []

    def begin(job: Job) -> None:
        shown.update(sum(one.done() for one in mine) - shown.n)
        shown.set_description(f"{what} {mine.index(job) + 1} of {len(mine)}")

    mine += jobs(lambda *_: nullcontext(shown))[shard[0] - 1 :: shard[1]]
    with bar(sum(job.size for job in mine), sum(job.done() for job in mine)) as shown:
        return work(folder, mine, begin)
