"""Errors that a user can mend, each one message without a traceback.

Anything raised here is the user's input or configuration (exit status 2 at the command line);
every other exception is a defect of ours (exit status 1).
"""

from __future__ import annotations


class AirswingError(Exception):
    """Base of every error airswing raises on purpose."""


class InputError(AirswingError):
    """Bad input, told in one message: what is wrong, where, what was found, what to do.

    Parameters
    ----------
    what : str
        What is wrong, in a short sentence.
    file : str or path-like, optional
        The file at fault.
    field : str, optional
        The column, variable or configuration key at fault.
    found : object, optional
        What was found there.
    remedy : str, optional
        What the user can do about it.
    """

    def __init__(
        self,
        what: str,
        *,
        file: object | None = None,
        field: str | None = None,
        found: object | None = None,
        remedy: str | None = None,
    ) -> None:
        self.what, self.file, self.field = what, file, field
        self.found, self.remedy = found, remedy
        places = [str(file)] if file is not None else []
        places += [field] if field is not None else []
        message = f"{': '.join(places)}: {what}" if places else what
        if found is not None:
            message += f" (found: {found})"
        if remedy is not None:
            message += f". {remedy}"
        super().__init__(message)

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild from the keywords, so that the error survives a trip between processes."""
        return _rebuild, (type(self), self.what, self.file, self.field, self.found, self.remedy)


class ConfigError(InputError):
    """A configuration that cannot be used."""


def _rebuild(
    kind: type[InputError],
    what: str,
    file: object | None,
    field: str | None,
    found: object | None,
    remedy: str | None,
) -> InputError:
    return kind(what, file=file, field=field, found=found, remedy=remedy)
