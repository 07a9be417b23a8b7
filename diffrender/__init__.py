"""Effects of game engines as differentiable tensors.

Conventions, each pinned by a test with one number:

Channels are last, `(..., 3)`; images `(..., height, width, 3)`, row 0 on top, pixel centres at +0.5. z is up, the frame
right-handed; metres, radians, seconds. +x is the horizontal direction under the centre of a picture, +y to its
left; azimuth counts from +x towards +y. Radiance is linear, Rec. 709 primaries, W/(m² sr) up to the photo's scale.
Degrees, hours and azimuths to the right exist only in files and on the command line. Output has the dtype, device and
batch shape of the inputs.
"""

from diffrender.catalogue import EFFECTS as EFFECTS
from diffrender.effect import Effect as Effect
from diffrender.effect import Rung as Rung
from diffrender.parameters import defaults as defaults
from diffrender.scene import Scene as Scene
