"""Reads OpenMetrics text from standard input with the parser of Prometheus' own Python client, which
refuses what the format does not allow, and prints every sample as one JSON object per line; with
--plain the same metrics in the older text format, which promtool reads."""

import json
import sys

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

families = list(text_string_to_metric_families(sys.stdin.read()))


class Families(Collector):
    def collect(self):
        return families


for family in families:
    if not family.documentation:
        sys.exit(f"{family.name} has no HELP text")
if "--plain" in sys.argv[1:]:
    registry = CollectorRegistry()
    registry.register(Families())
    sys.stdout.write(generate_latest(registry).decode())
    sys.exit()
for family in families:
    for sample in family.samples:
        print(json.dumps({"family": family.name, "type": family.type, "name": sample.name,
                          "labels": sample.labels, "value": sample.value}))
