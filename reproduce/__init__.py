"""The papers' experiments and our tables, measured again: ``python -m reproduce ID``.

They use public names of `twistcap` only, so each file is also a worked example. README.md lists claims and figures.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy, as the command line: its sums depend on the number
