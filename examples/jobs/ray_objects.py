"""Fits each object below OBJECTS whose folder has a scene.ron as a Ray task, on a file system that all nodes share.

    python ray_objects.py photos out

The same command goes on with what was stopped. When all have ended: lobelia report out/* --csv > runs.csv
"""

import pathlib
import subprocess
import sys

import ray


@ray.remote(num_cpus=2, max_retries=3)
def run(scene, out):
    """Runs an object; one that was begun on another node goes on."""
    command = ["lobelia", "run", scene, "--out", out, "--resume", "--threads", "2", "--quiet"]
    return subprocess.run(command, check=False).returncode


def main():
    objects, out = (pathlib.Path(path).absolute() for path in sys.argv[1:3])
    scenes = sorted(objects.glob("*/scene.ron"))
    ray.init()
    codes = ray.get([run.remote(str(scene), str(out / scene.parent.name)) for scene in scenes])
    failed = [scene.parent.name for scene, code in zip(scenes, codes) if code != 0]
    sys.exit(f"failed: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
