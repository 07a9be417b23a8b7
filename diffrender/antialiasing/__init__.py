"""Anti-aliasing after post effects: FXAA, two frames at pixel edges, two frames at checkerboard corners."""
