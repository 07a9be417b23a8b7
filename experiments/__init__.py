"""Measurements of the library: each is a function to records, and a command that prints, writes JSON and draws it."""
