"""Where things are: which lights reach which part of the screen, and what lies in shadow."""
