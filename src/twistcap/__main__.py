"""``python -m twistcap``: the command line."""

from twistcap.cli import main

if __name__ == "__main__":
    main()
