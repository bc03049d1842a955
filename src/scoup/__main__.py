"""The command line as `python -m scoup`."""

from scoup.cli import entry

if __name__ == "__main__":
    entry()
