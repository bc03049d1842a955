"""``python -m benchmarks``: one command for all studies."""

from __future__ import annotations

import sys

from benchmarks.study import Study, run
from scoup.base import ScoupError
from scoup.cli import Family
from scoup.cli.parsing import parse

STUDIES = Family(
    """Measure what the documents say. Each study prints a table and, with --out FILE.json, writes its figures with the
    machine and the commit; docs/benchmarks has those that the documents cite, `python -m benchmarks.documents` makes
    their tables.
    """,
    {
        "answers": "benchmarks.answers:Answers",
        "real": "benchmarks.answers:Real",
        "things": "benchmarks.things:Things",
        "agents": "benchmarks.agents:Agents",
        "laptop": "benchmarks.laptop:Laptop",
        "lerf-sized": "benchmarks.lerf_sized:LerfSized",
        "gpu": "benchmarks.gpu:Gpu",
        "query": "benchmarks.query:Query",
        "first-words": "benchmarks.first_words:FirstWords",
        "stages": "benchmarks.stages:Stages",
        "viewer": "benchmarks.viewer:ViewerCost",
        "archive-times": "benchmarks.archive_times:ArchiveTimes",
        "compare": "benchmarks.compare:Compare",
        "registration": "benchmarks.registration:Registration",
    },
)


def main(words: list[str]) -> int:
    """Run the study that the words name; the exit code."""
    try:
        study = parse(words, STUDIES, "python -m benchmarks")
        assert isinstance(study, Study)
        run(study, words[0])
        return 0
    except ScoupError as error:
        print(error, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
