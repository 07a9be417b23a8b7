"""Weather: parameters over the hours of a day, and what mixes several weathers into the one that is drawn.

A weather is a set of parameters: values by name, in the names and units of the `known` specifications given with them.
So the functions here work on a record, `Sky(**blend(vars(hazy), vars(clear), share, specifications(Sky)))`, as well as
on all names of a weather file.

In the talk [1] game entities carry weathers: area boxes and sequence nodes, which animate parameters and change the
weather. It does not say how a value is found between keyframes, where an area's weather fades, in which scale two
weathers are mixed, or what several at once make of it. What is decided here stands in the docstrings.

[1] M. Miyamoto, R. Driancourt, "Rendering techniques of Final Fantasy XV", SIGGRAPH 2016.
"""
