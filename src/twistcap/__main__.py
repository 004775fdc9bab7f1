"""``python -m twistcap``: the command line."""

from twistcap.cli import main

main()
