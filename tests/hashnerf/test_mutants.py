"""Mutants: each operator on an example made by hand, and what is left alone."""

import ast
import warnings

import pytest

from hashnerf.mutants import mutants_of


def changes(source: str) -> list[tuple[str, str]]:
    """What each mutant of a source changes."""
    return [(mutant.before, mutant.after) for mutant in mutants_of(source)]


@pytest.mark.parametrize(
    ("before", "afters"),
    [
        ("a < b", ["a <= b", "a >= b"]),
        ("a <= b", ["a < b", "a > b"]),
        ("a > b", ["a >= b", "a <= b"]),
        ("a >= b", ["a > b", "a < b"]),
        ("a == b", ["a != b"]),
        ("a != b", ["a == b"]),
        ("a is b", ["a is not b"]),
        ("a is not b", ["a is b"]),
        ("a in b", ["a not in b"]),
        ("a not in b", ["a in b"]),
        ("a < b < c", ["a <= b < c", "a >= b < c", "a < b <= c", "a < b >= c"]),
        ("a + b", ["a - b"]),
        ("a - b", ["a + b"]),
        ("a * b", ["a / b"]),
        ("a / b", ["a * b"]),
        ("a // b", ["a * b"]),
        ("a % b", ["a * b"]),
        ("a ** b", ["a * b"]),
        ("a << b", ["a >> b"]),
        ("a >> b", ["a << b"]),
        ("a & b", ["a | b"]),
        ("a | b", ["a & b"]),
        ("a ^ b", ["a & b"]),
        ("a and b and c", ["a or b or c"]),
        ("a or b", ["a and b"]),
        ("not a", ["a"]),
        ("-a", ["a"]),
        ("~a", ["a"]),
        ("a == 'x'", ["a != 'x'", "a == 'x!'"]),
        ("a == b'x'", ["a != b'x'", "a == b'x!'"]),
        ("a + b'x'", ["a - b'x'"]),
    ],
)
def test_expressions(before, afters):
    assert changes(f"x = {before}") == [(before, after) for after in afters]


@pytest.mark.parametrize(
    ("before", "afters"),
    [
        ("x = 0", ["x = 1"]),
        ("x = 1", ["x = 0"]),
        ("x = 7", ["x = 8"]),
        ("x = 0.0", ["x = 1.0"]),
        ("x = 1.5", ["x = 3.0"]),
        ("x = -2", ["2", "-3"]),
        ("x = True", ["x = False"]),
        ("x = False", ["x = True"]),
        ("x = None", []),
        ("x = 'text'", []),
        ("x += a", ["x -= a", "pass"]),
        ("x -= a", ["x += a", "pass"]),
        ("a.x = b", ["pass"]),
        ("a.x: int = b", ["pass"]),
        ("a[x] = b", ["pass"]),
        ("a.x: int", []),
        ("x = b", []),
        ("call(a)", ["pass"]),
        ("del a[b]", ["pass"]),
        ("raise Error('text')", ["pass"]),
        ("a.append(f'{b + 1}')", ["pass"]),
        # no logs, whatever they are called
        ("a.error(b)", ["pass"]),
        ("log.close(b)", ["pass"]),
        ("__x = 2", ["__x = 3"]),
    ],
)
def test_statements(before, afters):
    assert [after for _, after in changes(before)] == afters


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("return", [("return", "pass")]),
        ("return a", [("return a", "return None")]),
        ("return None", []),
        ("return 'x'", [("return 'x'", "return None"), ("return 'x'", "return 'x!'")]),
        ("return ('x', a)", [("return ('x', a)", "return None"), ("('x', a)", "('x!', a)")]),
        ("return f('x')", [("return f('x')", "return None")]),
        (
            "return 'x' if b else 'y'",
            [
                ("return 'x' if b else 'y'", "return None"),
                ("b", "not b"),
                ("'x' if b else 'y'", "'x!' if b else 'y'"),
                ("'x' if b else 'y'", "'x' if b else 'y!'"),
            ],
        ),
        ("await f()", [("await f()", "pass")]),
    ],
)
def test_functions(body, expected):
    assert changes(f"async def function(a):\n    {body}") == expected


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("if a:\n    b", [("a", "not a")]),
        ("while a and b:\n    c", [("a and b", "not (a and b)"), ("a and b", "a or b")]),
        ("x = a if b else c", [("b", "not b")]),
        ("x = [a for a in b if c]", [("c", "not c")]),
        ("if a < b < c:\n    d", [("a < b < c", "not a < b < c"), *changes("x = a < b < c")]),
        ("match a:\n    case b if c:\n        d", [("c", "not c")]),
        ("match a:\n    case 'x':\n        d", [("'x'", "'x!'")]),
        # one change of these says what a negation would say
        ("if a == b:\n    c", [("a == b", "a != b")]),
        ("if not a:\n    b", [("not a", "a")]),
        ("while True:\n    b", [("True", "False")]),
        ("while a:\n    break", [("a", "not a"), ("break", "pass")]),
        ("for a in b:\n    continue", [("continue", "pass")]),
    ],
)
def test_conditions_and_loops(source, expected):
    assert changes(source) == expected


@pytest.mark.parametrize(
    "source",
    [
        '"""Text of 3 == 3."""',
        'def f():\n    """Text."""',
        'class A:\n    x: str = "a"\n    """Text."""',
        "def f(a: 'int' = b, *c: A[3]) -> B[1]:\n    a",
        "x: A[3 | 4] = b",
        "print(1 + 2)",
        "logger.warning('text %s', 1 + 2)",
        "self.log.error(1)",
        "warnings.warn('text', stacklevel=2)",
        "x = f'{1 + 2:.3f}'",
        "__all__ = [1]",
        "@dataclass(frozen=True)\nclass A:\n    x: int",
        "@dataclasses.dataclass(frozen=True)\nclass A:\n    x: int",
        "if TYPE_CHECKING:\n    x = 1",
        "if typing.TYPE_CHECKING:\n    x = 1",
        "import a",
    ],
)
def test_what_only_people_read_is_left_alone(source):
    assert changes(source) == []


def test_mutants_that_do_not_compile_or_come_twice_are_left_out():
    assert changes("match x:\n    case {0: a, 1: b}:\n        c") == []  # a key twice is an error of syntax
    assert changes("x = --a") == [("--a", "-a")]  # whichever minus is dropped


def test_odd_mutants_do_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert changes("x = a is 3") == [("a is 3", "a is not 3"), ("a is 3", "a is 4")]


def test_a_long_expression_is_not_shown_around_a_constant():
    short = f"f({'a' * 94}, 2)"
    assert len(short) == 100 and changes(f"x = {short}") == [(short, short.replace("2", "3"))]
    assert changes(f"x = g{short}") == [("2", "3")]


def test_defaults_and_constants_are_mutated():
    source = "LIMIT = 2\n\n@dataclass(frozen=True)\nclass A:\n    x: float = 0.5\n\ndef f(a, b=3, *, c=4):\n    f(d=5)"
    found = [mutant for mutant in mutants_of(source) if mutant.after != "pass"]
    afters = ["LIMIT = 3", "x: float = 1.0", "5", "4", "d=6"]
    assert [mutant.after for mutant in found] == afters
    assert [mutant.line for mutant in found] == [1, 5, 7, 7, 8]


def test_each_mutant_is_a_whole_module_with_one_change():
    source = "def f(a):\n    if a > 3 and a != 5:\n        return a + 1\n    return 0\n"
    mutants = list(mutants_of(source))
    original = ast.unparse(ast.parse(source)).splitlines()
    for mutant in mutants:
        compile(mutant.source, "mutant", "exec")
        changed = [
            number for number, (old, new) in enumerate(zip(original, mutant.source.splitlines()), 1) if old != new
        ]
        assert changed == [mutant.line]
    assert len({mutant.source for mutant in mutants}) == len(mutants)
    # line 2: negated, and -> or, > twice, 3 -> 4, != , 5 -> 6; line 3: None, -, 1 -> 0; line 4: None, 0 -> 1
    assert [mutant.line for mutant in mutants] == [2] * 7 + [3] * 3 + [4] * 2


def test_the_order_is_always_the_same():
    source = "x = {'a': 1, 'b': 2} if a in ('c', 'd') else -1.5\n"
    assert list(mutants_of(source)) == list(mutants_of(source))


def test_a_file_that_is_no_module_is_refused():
    with pytest.raises(SyntaxError):
        list(mutants_of("if"))
