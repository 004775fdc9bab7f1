"""The papers' experiments and our tables, measured again: ``python -m reproduce ID``.

They use public names of `twistcap` only, so each file is also a worked example. README.md lists claims and figures.
"""
