"""Changes many files by hand: `python -m tests.fuzz --count 1000` of each kind, in a clone."""

import argparse
import tempfile
from pathlib import Path

from tests.fuzz.files import kinds
from tests.fuzz.fuzzing import Report, try_files

BATCH = 100  # of each kind between two lines


def main() -> None:
    """Reads the changed files, and prints what became of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="files of each kind")
    parser.add_argument("--seed", type=int, default=0, help="another seed gives other files")
    parser.add_argument("--first", type=int, default=0, help="number of the first file of each")
    parser.add_argument("--only", default="", help="kinds whose name has this in it")
    arguments = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        chosen = [kind for kind in kinds(Path(name)) if arguments.only in kind.name]
        total = Report.nothing()
        for first in range(arguments.first, arguments.first + arguments.count, BATCH):
            count = min(BATCH, arguments.first + arguments.count - first)
            report = try_files(chosen, Path(name), arguments.seed, first, count)
            total = total.with_more(report)
            failed += len(report.failures)
            done = sum(total.outcomes.values())
            print(f"{done} files, {failed} failures, {total.peak} MB at most", flush=True)
            for failure in report.failures:
                print(f"{failure.kind} {failure.number}: {failure.problem}", flush=True)
    for (kind, outcome), count in sorted(total.outcomes.items()):
        print(f"{kind}: {count} {outcome}")
    raise SystemExit(failed > 0)


if __name__ == "__main__":
    main()
