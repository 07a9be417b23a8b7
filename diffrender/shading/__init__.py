"""How surfaces send light on."""
