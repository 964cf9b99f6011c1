"""A run in Rerun's viewer (https://rerun.io, `pip install rerun-sdk`): curves of fits, what the run says, and the pictures of its passes.

    lobelia run SCENE --out OUT --log json | python examples/rerun/log_to_rerun.py OUT
    lobelia run SCENE --out OUT --log json | python examples/rerun/log_to_rerun.py OUT --save run.rrd
"""

import argparse
import json
import sys
from pathlib import Path

import rerun as rr

LEVELS = {"note": rr.TextLogLevel.WARN, "result": rr.TextLogLevel.INFO}


def log_step(name, event):
    """The curves of a `Fit` or `Shape`, over its steps."""
    rr.set_time("step", sequence=event["step"])
    for curve in ("loss", "psnr", "roughness", "lobes"):
        rr.log(f"{name}/{curve}", rr.Scalars(event[curve]))
    rr.log(f"{name}/specular_albedo", rr.Scalars(event["specular"]))


def log_pictures(out, name):
    """The pictures that a pass has written."""
    for path in sorted((out / name).glob("*.png")):
        rr.log(f"{name}/{path.stem}", rr.EncodedImage(path=path))


def follow(lines, out):
    """Logs the events of a run; returns how it ended."""
    name = None
    for line in lines:
        event = json.loads(line)
        rr.set_time("run", duration=event["secs"])
        kind = event["event"]
        if kind in ("pass", "ended") and name is not None:
            log_pictures(out, name)
        if kind == "pass":
            name = event["name"]
            rr.log("run", rr.TextLog(f"pass {name}, {event['number']} of {event['count']}"))
        elif kind == "step":
            log_step(name, event)
        elif kind in LEVELS:
            rr.log("run", rr.TextLog(event["text"], level=LEVELS[kind]))
        elif kind == "ended":
            return event
    return {"state": "gone", "error": "the run has not said how it ended"}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path, help="output folder of the run")
    parser.add_argument("--save", type=Path, help="write a recording instead of opening the viewer")
    arguments = parser.parse_args()
    rr.init("lobelia", spawn=arguments.save is None)
    if arguments.save is not None:
        rr.save(arguments.save)
    ended = follow(sys.stdin, arguments.out)
    if ended["state"] != "finished":
        sys.exit(f"{ended['state']}: {ended['error']}")


if __name__ == "__main__":
    main()
