"""Texts of exports from the templates beside this file."""

from importlib.resources import files

import jinja2


def rendered(name: str, **values: object) -> str:
    """Text of a template; every name that it holds must have a value."""
    text = files("fit.export").joinpath(name).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=False, undefined=jinja2.StrictUndefined, keep_trailing_newline=True, trim_blocks=True
    )
    return environment.from_string(text).render(values)


def one_line(text: str) -> str:
    """A weather file's name as it may stand in a comment or a string of any language."""
    return "".join(letter if letter.isalnum() or letter in " .,_-+" else "?" for letter in text)
