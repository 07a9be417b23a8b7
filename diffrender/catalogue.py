"""All effects by name, in drawing order: the only file that knows them all."""

from diffrender.atmosphere import celestial
from diffrender.effect import Effect

EFFECTS: dict[str, Effect] = {"sun disc": celestial.EFFECT}
