"""Reads OpenMetrics text from standard input with the parser of Prometheus' own Python client, which
refuses what the format does not allow, and prints every sample as one JSON object per line."""

import json
import sys

from prometheus_client.openmetrics.parser import text_string_to_metric_families

families = list(text_string_to_metric_families(sys.stdin.read()))
for family in families:
    if not family.documentation:
        sys.exit(f"{family.name} has no HELP text")
    for sample in family.samples:
        print(json.dumps({"family": family.name, "type": family.type, "name": sample.name,
                          "labels": sample.labels, "value": sample.value}))
