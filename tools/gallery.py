"""The pictures of the tasks in README, of the trained teams: python tools/gallery.py [FOLDER]"""

import sys
from pathlib import Path

from assistax.evaluation import play
from assistax.evaluation.film import film
from assistax.tasks import TASKS
from assistax.training.team_file import load_team, trained_file


def picture(task: str, folder: Path) -> None:
    """TASK.webp and, from the middle of the same episode, TASK.png."""
    env, team = load_team(trained_file(task))
    filmed = play(env, team, 9)["filmed"]
    film(filmed, folder / f"{task}.webp", width=400, height=300)
    film(filmed.first(len(filmed.qpos) // 2), folder / f"{task}.png", width=960, height=640)


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images")
    for task in dict.fromkeys(spec.name for spec in TASKS.values()):
        picture(task, folder)
        print(f"wrote {folder / task}.webp and .png")
