"""HTML pages made of the packaged templates: self-contained, and whatever text goes into one stays text."""

from importlib import resources
from pathlib import Path

import jinja2

from fit.input_error import InputError
from fit.whole_file import write_bytes


def template(file: str) -> jinja2.Template:
    """A packaged template: what is put into it is escaped, and what is unseen or turns the reading is spelt out."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: resources.files("fit").joinpath(name).read_text("utf-8")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(file)


def write(path: Path, html: str) -> None:
    """Write a page.

    Raises:
        InputError: for a path that is no HTML file's, or cannot be written.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out {path}; what is written is a page: give a name that ends in .html")
    write_bytes(path, html.encode())


def _visible(value: object) -> object:
    # File names may hold control characters, marks that turn the reading direction, and bytes that are not text.
    if not isinstance(value, str) or hasattr(value, "__html__") or value.isprintable():
        return value
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in value)
