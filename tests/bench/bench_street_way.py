"""What simulated streets show of speed and pitch: sound, with a speed in km/h, and with a pitch 12° off.

`python tests/bench/bench_street_way.py [--metres M] [--seeds N]`: how many times longer things seem along the road than
upwards, and the share of the edges that lean, of each drive: two scanners, 0.8 to 3 m/s, few trees or many, bare or in
leaf, pitches of 0 and 20°.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from fwclass import conf
from fwclass.conf.street import scanner
from fwclass.street.frames import Frame
from fwclass.street.simulate import simulate_frames
from fwclass.street.track import Track


def settings(seed: int, pitch: float, metres: float) -> tuple[str, ...]:
    scene = {
        "seed": seed,
        "length": metres,
        "stops": 0,
        "leaves": seed % 3 > 0,
        "tree_spacing": 6 if seed % 2 else 15,
        "speed": (1.5, 0.8, 3)[seed % 3],
    }
    street = ("street.scanner=" + ("lms1xx" if seed % 4 else "utm-30lx"), f"street.mounting.pitch={pitch}")
    return (*(f"street_scene.{name}={value}" for name, value in scene.items()), *street)


def measured(frames: list[Frame], speed: float, pitch: float) -> tuple[float, float]:
    """Stretch and share of leaning edges where speeds are `speed` times as high; NaN where nothing tells."""
    track = Track(conf.load("street-sim", (f"street.mounting.pitch={pitch}",)).street)
    for frame in frames:
        track.take(replace(frame, speed=speed * frame.speed))
    facts = track.counts()["sound"]
    stretch, share = (float("nan") if facts[k] is None else facts[k] for k in ("stretch", "lean_share"))
    return stretch, share


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--metres", type=float, default=105.0)
    ask.add_argument("--seeds", type=int, default=8)
    asked = ask.parse_args()
    print("seed pitch   sound: stretch  leaning   km/h: stretch   12° off: leaning")
    for pitch in (0.0, 20.0):
        for seed in range(21, 21 + asked.seeds):
            config = conf.load("street-sim", settings(seed, pitch, asked.metres))
            frames = list(simulate_frames(config.street_scene, scanner(config.street.scanner), config.street.mounting))
            stretch, share = measured(frames, 1.0, pitch)
            fast, off = measured(frames, 3.6, pitch)[0], measured(frames, 1.0, pitch + 12.0)[1]
            print(f"{seed:4d} {pitch:5.0f} {stretch:15.2f} {share:8.2f} {fast:15.2f} {off:18.2f}", flush=True)


if __name__ == "__main__":
    main()
