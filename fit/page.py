"""HTML pages made of the packaged templates: self-contained, and whatever text goes into one stays text."""

from importlib import resources

import jinja2


def template(file: str) -> jinja2.Template:
    """A packaged template: what is put into it is escaped, and what is unseen or turns the reading is spelt out."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, finalize=_visible, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(resources.files("fit").joinpath(file).read_text("utf-8"))


def _visible(value: object) -> object:
    # File names may hold control characters, marks that turn the reading direction, and bytes that are not text.
    if not isinstance(value, str) or hasattr(value, "__html__") or value.isprintable():
        return value
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in value)
