"""Shot: where and when a photo was taken."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from fit import sun
from fit.input_error import InputError
from fit.solution import SunPlace


@dataclass(frozen=True)
class Shot:
    """Where and when a photo was taken; None where that is not known.

    Attributes:
        latitude: degrees north.
        longitude: degrees east.
        time: local time.
        heading: compass bearing of the picture's middle column, in degrees.
    """

    latitude: float | None = None
    longitude: float | None = None
    time: datetime | None = None
    heading: float | None = None

    def sun(self) -> SunPlace | None:
        """Sun at this place and time; None where neither is known.

        Raises:
            InputError: when only a part of them is, or one is out of range.
        """
        if self.latitude is None and self.longitude is None and self.time is None:
            return None
        if self.latitude is None or self.longitude is None or self.time is None:
            raise InputError("the sun's place needs --latitude, --longitude and --time together; or give --sun")
        return sun.from_place(self.latitude, self.longitude, self.time, self.heading or 0.0)

    def sun_by(self, header: Mapping[str, object]) -> SunPlace | None:
        """Sun by a photo's header too, which tells neither where the picture looks nor always place and time.

        None where any of them stays unknown.
        """
        whole = self.completed(header)
        if self.heading is None or whole.latitude is None or whole.longitude is None or whole.time is None:
            return None
        return whole.sun()

    def completed(self, header: Mapping[str, object]) -> "Shot":
        """Shot with what a photo's header says where nothing else is known."""
        time, latitude, longitude = (header.get(name) for name in ("time", "latitude", "longitude"))
        whole = self
        if self.time is None and isinstance(time, datetime):
            whole = replace(whole, time=time)
        # Latitude and longitude of one source: one from here and one from there would be nowhere.
        nowhere = self.latitude is None and self.longitude is None
        if nowhere and isinstance(latitude, float) and isinstance(longitude, float):
            whole = replace(whole, latitude=latitude, longitude=longitude)
        return whole

    @property
    def hour(self) -> float | None:
        """Local hour of the day."""
        return None if self.time is None else self.time.hour + self.time.minute / 60.0 + self.time.second / 3600.0

    def lines(self) -> dict[str, str]:
        """Lines of a weather file's header; none for what is not known."""
        angles = {"latitude": self.latitude, "longitude": self.longitude}
        # Seven digits: a photo's header holds no more, and they are a centimetre on the ground.
        found = {name: f"{degrees:.7g}" for name, degrees in angles.items() if degrees is not None}
        if self.time is not None:
            found["date"] = self.time.date().isoformat()
        if self.heading is not None:
            found["heading"] = f"{self.heading:.7g}"
        return found


def sun_of_weather(header: Mapping[str, str], hour: float, heading: float | None = None) -> SunPlace | None:
    """Sun at an hour by a weather file's header; None where it does not name place, date and zone.

    A heading that is given goes before the header's.

    Raises:
        InputError: when it names them in a way that cannot be understood.
    """
    wanted = ("latitude", "longitude", "date", "zone")
    if any(name not in header for name in wanted):
        return None
    said = ", ".join(f"{name}: {header[name]}" for name in wanted)
    try:
        midnight = datetime.fromisoformat(f"{header['date']}T00:00{header['zone']}")
        latitude, longitude, told = (float(header.get(name, "0")) for name in ("latitude", "longitude", "heading"))
    except ValueError:
        raise InputError(
            f"the weather file's header says {said}; give degrees, a date such as 2016-08-14 and a zone such as +02:00"
        ) from None
    middle = told if heading is None else heading
    return sun.from_place(latitude, longitude, midnight + timedelta(hours=hour), middle % 360.0)
