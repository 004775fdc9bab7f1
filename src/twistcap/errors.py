"""The one exception that a user's input can cause."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input, told in one sentence that names the file, the field and the mend.

    The command line prints the sentence alone and exits with code 2.
    """
