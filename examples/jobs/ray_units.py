"""All units of JOBS as Ray tasks, on a file system that all nodes share: python ray_units.py objects.csv out [--data DIR] [--frames N]"""

import argparse
import json
import subprocess
import sys

import ray


@ray.remote(num_cpus=2, max_retries=3)
def run_unit(jobs, unit, out, data):
    """Runs a unit; one that was begun on another node goes on."""
    command = ["lobelia", "run", jobs, "--only", unit, "--out", out, "--threads", "2", "--quiet"]
    return unit, subprocess.run(command + data, check=False).returncode


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("jobs")
    parser.add_argument("out")
    parser.add_argument("--data", help="what $DATA stands for")
    parser.add_argument("--frames", default="24", help="frames of a unit of a film")
    args = parser.parse_args()
    data = ["--data", args.data] if args.data else []
    of_jobs = ["--frames", args.frames] + data
    units = json.loads(subprocess.check_output(["lobelia", "list", args.jobs, "--json"] + of_jobs))
    ray.init()
    codes = ray.get([run_unit.remote(args.jobs, unit["name"], args.out, data) for unit in units])
    failed = [unit for unit, code in codes if code != 0]
    report = subprocess.run(["lobelia", "report", args.out, "--jobs", args.jobs] + of_jobs, check=False)
    sys.exit(f"failed: {', '.join(failed)}" if failed else report.returncode)


if __name__ == "__main__":
    main()
