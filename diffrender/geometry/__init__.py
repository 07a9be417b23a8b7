"""Where things are: shapes that rays meet, which lights reach which part of the screen, and what lies in shadow."""
