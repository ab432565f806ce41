"""Generated gyro samples of a robot that shakes for a while and then stands still."""

from __future__ import annotations

from random import Random

from failstop_lab.prove.shake import GyroSample, Noise
from failstop_lab.prove.sight import ByImu

S = 1_000_000_000
RATE_HZ = 110
STILL = 0.0020
TURN = 0.0043
DRIVE = 0.0055


def gyro(*stretches: tuple[float, float], seed: int = 1, start_ns: int = 0, bias: float = 0.01) -> list[GyroSample]:
    """(seconds, standard deviation in rad/s) one after the other."""
    random = Random(seed)
    found: list[GyroSample] = []
    for seconds, std in stretches:
        for _ in range(round(seconds * RATE_HZ)):
            t_ns = start_ns + len(found) * S // RATE_HZ
            found.append((t_ns, random.gauss(bias, std), random.gauss(-bias, std)))
    return found


def level(std: float) -> Noise:
    return Noise(std, std, 0.85 * std, 1.2 * std, 0.0, 0.0, RATE_HZ)


SIMULATED = ByImu(
    still=level(STILL), spinning={"0.2": level(DRIVE), "turn": level(TURN)}, limit_radps=0.0035, configured_radps=0.0035
)
"""The character of the simulated board."""
