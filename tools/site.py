"""The documentation site: uv run --only-group docs python tools/site.py [serve]

Pages link to each other as they lie in the repository, so that links work there, too. Here they are staged with the
same places, and built strictly: a broken link or anchor is an error. The result is .site/html.
"""

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ROOT / ".site" / "pages"
SHOWN = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**/*", "results/README.md", "results/**/*.png")


def stage() -> None:
    """Copy what the site shows to PAGES."""
    shutil.rmtree(PAGES, ignore_errors=True)
    for pattern in SHOWN:
        for path in ROOT.glob(pattern):
            if path.is_file():
                place = PAGES / path.relative_to(ROOT)
                place.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, place)


if __name__ == "__main__":
    stage()
    command = ["serve"] if "serve" in sys.argv[1:] else ["build", "--clean", "--strict"]
    sys.exit(subprocess.run([sys.executable, "-m", "zensical", *command], cwd=ROOT).returncode)
