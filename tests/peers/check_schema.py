"""Validates messages by their JSON Schema with a validator that is not Muster's.

Standard input is one JSON object: `document`, the schema of all messages, `alone`, schemas that stand
by themselves, and `cases`, pairs of the name of a message and its text. Standard output is one array:
null for each case that the schema accepts, and what is wrong for each that it refuses. A schema that is
none itself ends the program.
"""

import json
import sys

from jsonschema import Draft202012Validator


def refuse_constant(name):
    raise ValueError(f"{name} is no JSON")


def problem(validators, name, text):
    try:
        message = json.loads(text, parse_constant=refuse_constant)
    except ValueError as error:
        return f"no JSON: {error}"
    error = next(validators[name].iter_errors(message), None)
    return error and f"{error.json_path}: {error.message}"[:300]


def main():
    task = json.load(sys.stdin)
    document = task["document"]
    for schema in [document, *task["alone"]]:
        Draft202012Validator.check_schema(schema)
    names = {name for name, _ in task["cases"]}
    validators = {
        name: Draft202012Validator({**document, "$ref": f"#/$defs/{name}"}) for name in names
    }
    json.dump([problem(validators, name, text) for name, text in task["cases"]], sys.stdout)


main()
