"""What a picture of rain is drawn from."""

from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record
from diffrender.weather.rain_drops import Drops, Moment
from diffrender.weather.rain_landing import Obstacles
from diffrender.weather.rain_tiles import Screen


@record
class RainView:
    """Drops, what they fall on, camera and wind, and the picture without rain, exposed already.

    The light is what a drop sends to the eye: in daylight about the mean of the sky above and of what lies behind,
    blurred, for a drop shows both; so streaks are bright before what is dark, and hardly seen before the sky.
    """

    drops: Drops
    obstacles: Obstacles
    moment: Moment
    drop_radius: Float[Tensor, "*#batch"]  # real drops have 0.2 to 3 mm [m]
    drop_number: Float[Tensor, "*#batch"]  # of real drops that each drawn one stands for: turned up, opaque streaks
    screen: Screen
    background: Float[Tensor, "*batch height width 3"]  # radiance [W/(m^2 sr)]
    light: Float[Tensor, "*#batch #height #width 3"]  # radiance [W/(m^2 sr)]
