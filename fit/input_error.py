"""InputError: something the user gave is wrong and the user can mend it."""


class InputError(ValueError):
    """One line that says what was given, what is allowed and what to do; the command line exits with 2."""
