"""All units of JOBS as Ray tasks, on a file system that all nodes share: python ray_units.py objects.csv out [--data DIR]"""

import json
import subprocess
import sys

import ray


@ray.remote(num_cpus=2, max_retries=3)
def run_unit(jobs, unit, out, options):
    """Runs a unit; one that was begun on another node goes on."""
    command = ["lobelia", "run", jobs, "--only", unit, "--out", out, "--threads", "2", "--quiet"]
    return unit, subprocess.run(command + options, check=False).returncode


def main():
    jobs, out, *options = sys.argv[1:]
    units = json.loads(subprocess.check_output(["lobelia", "list", jobs, "--json"] + options))
    ray.init()
    codes = ray.get([run_unit.remote(jobs, unit["name"], out, options) for unit in units])
    subprocess.run(["lobelia", "report", out], check=True)
    failed = [unit for unit, code in codes if code != 0]
    sys.exit(f"failed: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
