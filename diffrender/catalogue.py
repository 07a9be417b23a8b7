"""All effects by name, in drawing order: the only file that knows them all."""

from diffrender.effect import Effect

EFFECTS: dict[str, Effect] = {}
