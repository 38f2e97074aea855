"""Whether this tree can be released: python tools/release.py

Builds sdist and wheel, installs the wheel into an empty environment, and plays a team there.
"""

import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]


def run(*command, **settings) -> str:
    print("+", *command, flush=True)
    return subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE, **settings).stdout


def check(folder: Path) -> None:
    run("uv", "build", "--quiet", "--out-dir", str(folder / "dist"), cwd=ROOT)
    wheel, sdist = next((folder / "dist").glob("*.whl")), next((folder / "dist").glob("*.tar.gz"))
    venv.create(folder / "venv", with_pip=False)
    python = folder / "venv" / "bin" / "python"
    run("uv", "pip", "install", "--quiet", "--python", str(python), str(wheel))
    here = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    alone = {"cwd": folder, "env": here}
    version = run(str(python), "-m", "assistax", "--version", **alone).strip()
    assert version.split()[-1] in wheel.name and version.split()[-1] in sdist.name, version
    told = run(
        str(python), "-m", "assistax", "evaluate", "scratch-v0", "--policy", "trained", "--episodes", "4", **alone
    )
    assert "success" in told, told
    code = "import assistax, pathlib; print((pathlib.Path(assistax.__file__).parent / 'py.typed').exists())"
    assert run(str(python), "-c", code, **alone).strip() == "True"
    print(f"{wheel.name} installs by itself and plays.")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(check(Path(folder)))
