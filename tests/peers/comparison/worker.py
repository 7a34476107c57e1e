"""Programs that answer one line of JSON with another."""

import json
import subprocess


class Failure(Exception):
    """A worker that cannot do what it is asked, in its own words."""


class Worker:
    def __init__(self, *command):
        self.process = subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, do, **fields):
        try:
            self.process.stdin.write(json.dumps({"do": do, **fields}) + "\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise Failure(f"{do}: ended with code {self.process.wait()}")
        answer = json.loads(line)
        if "error" in answer:
            raise Failure(f"{do}: {answer['error']}")
        return answer

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.stdin.close()
        self.process.wait()
