"""What can be wrong with an input or a plan: every error names the field, the value and the legal ones."""

from collections.abc import Sequence


class RegraspError(Exception):
    """The base of every error that regrasp raises on purpose."""


class InputError(RegraspError):
    """Bad input: a file, a field of a scene, a setting or a command-line value.

    `field` is the path of the field (`object.mass`), `reason` what is wrong with its value, `hint` the legal values or
    the remedy, `file` where it stands, `others` the further errors found in the same input. `str()` is the one line
    shown to the user: `file: field: reason (hint)`, followed by `and N more` when there are others.
    """

    def __init__(
        self, field: str, reason: str, hint: str = "", file: str = "", others: Sequence["InputError"] = ()
    ) -> None:
        self.field = field
        self.reason = reason
        self.hint = hint
        self.file = file
        self.others = tuple(others)
        where = f"{file}: {field}" if file else field
        line = f"{where}: {reason} ({hint})" if hint else f"{where}: {reason}"
        super().__init__(f"{line} and {len(self.others)} more" if self.others else line)
