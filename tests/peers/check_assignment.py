#!/usr/bin/env python3
"""Compares the exact assignment of shared/numeric with OR-tools on random fleets.

    python3 -m venv venv && venv/bin/pip install -r tests/peers/requirements.txt
    cargo build --package muster-numeric --example assign
    venv/bin/python tests/peers/check_assignment.py target/debug/examples/assign [--seed S] [--cases N]

Of every ten cases, seven are limits alone against CP-SAT, two have wishes and overlapping needs against CP-SAT, and
one is large against OR-tools' minimum-cost flow. Costs have to be equal, or of wishes within the gap that is told.
Where there is no assignment, CP-SAT proves that the conflicting set cannot be satisfied, and that it can without any
one of its members. Ends with 'N passed, N failed', and code 1 if anything failed.
"""

import argparse
import random
import subprocess
import sys
from collections import Counter

from ortools.graph.python import min_cost_flow
from ortools.sat.python import cp_model

BUDGET = 3000  # nodes of the search


def bounds_around(rng, share, room):
    middle = share + rng.randint(-1, 1)
    lower = max(0, middle - room - rng.randint(0, 2))
    upper = max(lower, middle + room + rng.randint(0, 2))
    return rng.choice([(lower, -1), (0, upper), (lower, upper), (0, -1)])


def make_case(seed, number):
    """Limits, wishes and costs, by seed and number alone."""
    rng = random.Random(f"{seed}/{number}")
    kind = "large" if number % 10 == 9 else "wishes" if number % 10 >= 7 else "limits"
    n = rng.randint(300, 1200) if kind == "large" else rng.randint(2, 24 if kind == "wishes" else 40)
    k = rng.randint(5, 20) if kind == "large" else rng.randint(1, 6)
    reserve = rng.random() < 0.5
    columns = k + reserve
    room = rng.randint(0, 2) if kind == "limits" else rng.randint(1, 3)
    case = {"kind": kind, "robots": n, "teams": k, "reserve": reserve, "columns": columns}
    case["bounds"] = [bounds_around(rng, n // k, room) for _ in range(k)]
    if reserve:
        case["bounds"].append((0, rng.randint(0, n // 2)))
    classes = rng.randint(0, 3)
    case["classes"] = [
        rng.randrange(classes) if classes and rng.random() < 0.6 else -1 for _ in range(n)
    ]
    largest = rng.choice([3, 1000, 2**30])
    case["limits"] = []
    for c in range(classes):
        for column in range(columns):
            if rng.random() < 0.4:
                lower, upper = bounds_around(rng, n // k // 3, room + 1)
                wanted = rng.randint(0, 4) if rng.random() < 0.3 else -1
                case["limits"].append((column, c, lower, upper, wanted, rng.randint(0, largest)))
    share = rng.choice([0.0, 0.1, 0.3])
    case["pairs"] = [
        (int(rng.random() < 0.7), robot, rng.randrange(columns))
        for robot in range(n) for _ in range(3) if rng.random() < share
    ]  # fmt: skip
    case["wishes"], case["needs"] = [], []
    if kind == "wishes":
        price = lambda: rng.randint(0, largest) if rng.random() < 0.3 else -1
        for _ in range(rng.randint(0, 5)):
            group = rng.sample(range(n), min(n, rng.randint(2, 4)))
            case["wishes"].append((rng.randint(0, 1), price(), group))
        for _ in range(rng.randint(1, 3)):
            skilled = [robot for robot in range(n) if rng.random() < 0.4]
            for column in range(k):
                if rng.random() < 0.7:
                    case["needs"].append((column, rng.randint(1, 2), price(), skilled))
    case["costs"] = [[rng.randint(-largest, largest) for _ in range(columns)] for _ in range(n)]
    return case


def encode(case):
    numbers = [case["robots"], case["teams"], int(case["reserve"])]
    for pair in case["bounds"]:
        numbers += pair
    numbers += case["classes"]
    for name in ("limits", "pairs"):
        numbers.append(len(case[name]))
        for entry in case[name]:
            numbers += entry
    for name in ("wishes", "needs"):
        numbers.append(len(case[name]))
        for *head, robots in case[name]:
            numbers += [*head, len(robots), *robots]
    numbers.append(BUDGET)
    for row in case["costs"]:
        numbers += row
    return " ".join(map(str, numbers))


def all_rules(case):
    rules = []
    for column, (lower, upper) in enumerate(case["bounds"]):
        rules.append(("least", column, -1, lower))
        if upper >= 0:
            rules.append(("most", column, -1, upper))
    for column, c, lower, upper, _, _ in case["limits"]:
        rules.append(("least", column, c, lower))
        if upper >= 0:
            rules.append(("most", column, c, upper))
    for forbidden, robot, column in case["pairs"]:
        rules.append(("forbidden" if forbidden else "forced", robot, column))
    return rules


class Model:
    """The rules as an integer program of one bit for each robot and column."""

    def __init__(self, case, rules):
        self.case, self.model = case, cp_model.CpModel()
        n, columns = case["robots"], case["columns"]
        bit = self.model.new_bool_var
        self.x = [[bit(f"x{i}_{j}") for j in range(columns)] for i in range(n)]
        for row in self.x:
            self.model.add_exactly_one(row)
        for rule in rules:
            if rule[0] == "forced":
                self.model.add(self.x[rule[1]][rule[2]] == 1)
            elif rule[0] == "forbidden":
                self.model.add(self.x[rule[1]][rule[2]] == 0)
            else:
                word, column, c, count = rule
                there = self.count(column, [i for i in range(n) if c < 0 or case["classes"][i] == c])
                self.model.add(there >= count if word == "least" else there <= count)

    def count(self, column, robots):
        return sum(self.x[i][column] for i in robots)

    def missing(self, column, robots, wanted):
        short = self.model.new_int_var(0, wanted, "")
        self.model.add(short >= wanted - self.count(column, robots))
        return short

    def wish(self, relation, price, robots):
        """Adds a wish; returns its cost."""
        broken = self.model.new_bool_var("") if price >= 0 else None
        for a, b in ((a, b) for a in robots for b in robots if a < b):
            for j in range(self.case["columns"]):
                if relation == 0:
                    made = self.model.add(self.x[a][j] == self.x[b][j])
                elif j < self.case["teams"]:
                    made = self.model.add(self.x[a][j] + self.x[b][j] <= 1)
                else:
                    continue
                if broken is not None:
                    made.only_enforce_if(broken.Not())
        return price * broken if broken is not None else 0

    def need(self, column, at_least, price, robots):
        """Adds a need; returns its cost."""
        if price < 0:
            self.model.add(self.count(column, robots) >= at_least)
            return 0
        return price * self.missing(column, robots, at_least)

    def solve(self, extra=None):
        """The least cost, or None; without `extra` only whether there is any."""
        if extra is not None:
            costs = self.case["costs"]
            terms = [c * x for row, bits in zip(costs, self.x) for c, x in zip(row, bits)]
            self.model.minimize(sum(terms) + extra)
        solver = cp_model.CpSolver()
        solver.parameters.num_workers = 1
        solver.parameters.max_time_in_seconds = 60
        status = solver.solve(self.model)
        if status == cp_model.INFEASIBLE:
            return None
        if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
            raise TimeoutError("CP-SAT did not end")
        if extra is not None and status != cp_model.OPTIMAL:
            raise TimeoutError("CP-SAT did not end")
        return round(solver.objective_value) if extra is not None else 0


def least_cost(case):
    model = Model(case, all_rules(case))
    extra = 0
    for column, c, _, _, wanted, price in case["limits"]:
        if wanted > 0:
            robots = [i for i in range(case["robots"]) if case["classes"][i] == c]
            extra += price * model.missing(column, robots, wanted)
    extra += sum(model.wish(*wish) for wish in case["wishes"])
    extra += sum(model.need(*need) for need in case["needs"])
    return model.solve(extra)


def flow_cost(case):
    """The least cost by OR-tools' minimum-cost flow; lower bounds are sent beforehand."""
    flow, supply, n = min_cost_flow.SimpleMinCostFlow(), Counter(), case["robots"]
    constant = 0
    cells = {(entry[0], entry[1]): n + case["columns"] + at for at, entry in enumerate(case["limits"])}
    sink = n + case["columns"] + len(cells)

    def add(start, end, lower, upper, cost):
        nonlocal constant
        if upper < lower:
            return False
        supply[start] -= lower
        supply[end] += lower
        constant += lower * cost
        if upper > lower:
            flow.add_arc_with_capacity_and_unit_cost(start, end, upper - lower, cost)
        return True

    possible = True
    allowed = [set(range(case["columns"])) for _ in range(n)]
    for forbidden, robot, column in case["pairs"]:
        allowed[robot] &= set(range(case["columns"])) - {column} if forbidden else {column}
    for robot in range(n):
        supply[robot] += 1
        for column in allowed[robot]:
            to = cells.get((column, case["classes"][robot]), n + column)
            flow.add_arc_with_capacity_and_unit_cost(robot, to, 1, case["costs"][robot][column])
    for column, c, lower, upper, wanted, price in case["limits"]:
        start, end, upper = cells[column, c], n + column, n if upper < 0 else min(upper, n)
        paid = max(0, min(wanted, upper, n))
        constant += price * max(0, wanted)
        possible &= add(start, end, min(lower, paid), paid, -price)
        possible &= add(start, end, lower - min(lower, paid), upper - paid, 0)
    for column, (lower, upper) in enumerate(case["bounds"]):
        possible &= add(n + column, sink, lower, n if upper < 0 else min(upper, n), 0)
    supply[sink] -= n
    for node in range(sink + 1):
        flow.set_node_supply(node, supply[node])
    if not possible or flow.solve() != flow.OPTIMAL:
        return None
    return flow.optimal_cost() + constant


def cost_of(case, labels):
    """What an answer costs by the definitions; None if something hard does not hold."""
    rules_hold = True
    there = lambda column, robots: sum(labels[i] == column for i in robots)
    of_class = lambda c: [i for i in range(case["robots"]) if c < 0 or case["classes"][i] == c]
    for rule in all_rules(case):
        if rule[0] in ("forced", "forbidden"):
            rules_hold &= (labels[rule[1]] == rule[2]) == (rule[0] == "forced")
        else:
            found = there(rule[1], of_class(rule[2]))
            rules_hold &= found >= rule[3] if rule[0] == "least" else found <= rule[3]
    cost = sum(row[label] for row, label in zip(case["costs"], labels))
    for column, c, _, _, wanted, price in case["limits"]:
        cost += price * max(0, wanted - there(column, of_class(c)))
    for relation, price, robots in case["wishes"]:
        counts = Counter(labels[i] for i in robots if relation == 0 or labels[i] < case["teams"])
        granted = len(counts) == 1 if relation == 0 else max(counts.values(), default=0) <= 1
        rules_hold &= granted or price >= 0
        cost += 0 if granted else max(price, 0)
    for column, at_least, price, robots in case["needs"]:
        short = max(0, at_least - there(column, robots))
        rules_hold &= short == 0 or price >= 0
        cost += short * max(price, 0)
    return cost if rules_hold else None


def conflict_error(case, rules):
    """What is wrong with a conflicting set, or None."""
    known = all_rules(case)
    if any(rule not in known for rule in rules):
        return "the conflict names a rule that is not there"
    if Model(case, rules).solve() is not None:
        return "the conflict can be satisfied"
    for dropped in set(rules):
        if Model(case, [rule for rule in rules if rule != dropped]).solve() is None:
            return f"the conflict does not need {dropped}"
    return None


def refusal_error(case, wishes, needs):
    """What is wrong with wishes and needs that are said to contradict each other, or None."""

    def possible(wishes, needs):
        model = Model(case, all_rules(case))
        costs = [model.wish(*case["wishes"][i]) for i in wishes]
        costs += [model.need(*case["needs"][i]) for i in needs]
        return model.solve() is not None

    if possible(wishes, needs):
        return "the refused wishes can be granted"
    for i in wishes:
        if not possible([w for w in wishes if w != i], needs):
            return f"wish {i} is not needed"
    for i in needs:
        if not possible(wishes, [w for w in needs if w != i]):
            return f"need {i} is not needed"
    return None


def check(case, answer, tally):
    """What is wrong with an answer, or None."""
    kind, _, rest = answer.partition(" ")
    if kind == "conflict":
        tally["conflicts"] += 1
        words = [rule.split() for rule in rest.split(" ; ")]
        rules = [(word[0], *map(int, word[1:])) for word in words]
        if case["kind"] != "large":
            return conflict_error(case, rules)
        return None if flow_cost(case) is None else "there is an assignment"
    if kind == "refused":
        tally["refused wishes"] += 1
        wishes, needs, irreducible = rest.split("|")
        if irreducible.strip() != "true":
            return "the budget did not suffice"
        return refusal_error(case, [*map(int, wishes.split())], [*map(int, needs.split())])
    cost, bound, *labels = map(int, rest.split())
    if cost_of(case, labels) != cost:
        return f"cost {cost} is {cost_of(case, labels)} by the definitions"
    best = flow_cost(case) if case["kind"] == "large" else least_cost(case)
    if best is None:
        return "there is no assignment"
    if case["kind"] != "wishes" or bound == cost:
        tally["equal"] += 1
        return None if bound == best == cost else f"cost {cost}, bound {bound}, and the least is {best}"
    tally["with a gap"] += 1
    return None if bound <= best <= cost else f"{best} is not from {bound} to {cost}"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("binary")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=200)
    options = parser.parse_args()
    cases = [make_case(options.seed, number) for number in range(options.cases)]
    text = "\n".join(map(encode, cases))
    run = subprocess.run([options.binary], input=text, capture_output=True, text=True)
    if run.returncode != 0:
        sys.exit(f"{options.binary} failed: {run.stderr}")
    failed, tally = 0, Counter()
    for number, (case, answer) in enumerate(zip(cases, run.stdout.splitlines(), strict=True)):
        error = check(case, answer, tally)
        if error is not None:
            failed += 1
            print(f"case {number} ({case['kind']}): {error}", file=sys.stderr)
    print(", ".join(f"{count} {name}" for name, count in sorted(tally.items())))
    print(f"{options.cases - failed} passed, {failed} failed")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
