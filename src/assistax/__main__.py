"""The `assistax` command, and `python -m assistax`."""

import sys


def main() -> None:
    """Loads nothing before it can say in one line that it was stopped."""
    if sys.platform == "win32":
        print("assistax: on Windows it runs in WSL only.", file=sys.stderr)
        sys.exit(2)
    try:
        from assistax.cli import main as run

        run()
    except KeyboardInterrupt:
        print("assistax: stopped.", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
