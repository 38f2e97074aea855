"""The `assistax` command, and `python -m assistax`."""

import sys


def main() -> None:
    """Loads nothing before it can say in one line that it was stopped."""
    try:
        from assistax.cli import main as run

        run()
    except KeyboardInterrupt:
        print("assistax: stopped.", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
