"""Every public name has a docstring, and an example on the page of the documentation."""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path

import flankwatch
import pytest
from flankwatch import _flankwatch

from conftest import ROOT
from test_notebooks import examples

STUB = Path(flankwatch.__file__).with_name("_flankwatch.pyi")
PAGE = ROOT / "docs/python.md"


def members(cls: type) -> dict[str, object]:
    """Public methods and properties that a class, or a base class of the package, defines."""
    kinds = (property, staticmethod, classmethod)
    return {
        name: member
        for base in cls.__mro__
        if base.__module__.startswith("flankwatch")
        for name, member in vars(base).items()
        if not name.startswith("_")
        and (callable(member) or isinstance(member, kinds) or inspect.isgetsetdescriptor(member))
    }


def methods(cls: type) -> list[str]:
    return [
        name
        for name, member in members(cls).items()
        if not isinstance(member, property) and not inspect.isgetsetdescriptor(member)
    ]


PUBLIC = {name: getattr(flankwatch, name) for name in flankwatch.__all__}
CLASSES = {name: each for name, each in PUBLIC.items() if inspect.isclass(each)}


def stubs() -> dict[str, ast.ClassDef | ast.FunctionDef]:
    """Classes, functions, methods and properties of the stub file, by qualified name."""
    found: dict[str, ast.ClassDef | ast.FunctionDef] = {}
    for node in ast.parse(STUB.read_text()).body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            found[node.name] = node
        if isinstance(node, ast.ClassDef):
            for member in node.body:
                if isinstance(member, ast.FunctionDef) and not member.name.startswith("_"):
                    found[f"{node.name}.{member.name}"] = member
    return found


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_have_docstrings(name):
    assert inspect.getdoc(PUBLIC[name]), name
    for member, value in members(PUBLIC[name]).items() if name in CLASSES else ():
        assert inspect.getdoc(value), f"{name}.{member}"


def test_stubs_repeat_the_native_docstrings():
    native = {name for name in vars(_flankwatch) if not name.startswith("_")}
    assert native == {name for name in stubs() if "." not in name}
    for name, node in stubs().items():
        value = _flankwatch
        for part in name.split("."):
            value = getattr(value, part)
        expected = " ".join((inspect.getdoc(value) or "").split())
        assert expected and " ".join((ast.get_docstring(node) or "").split()) == expected, name


#: A shape such as ``(n,)`` or ``(turns, samples_per_turn)``.
SHAPE = re.compile(r"shape ``\(.+?\)``")

UNITS = re.compile(r"\b(rad|mm|µm|N/m|Hz|hertz|seconds|in ``unit``|m/s²|Orders of|without a unit)(?!\w)")


def test_arrays_have_a_shape_and_a_unit():
    arrays = 0
    for name, node in stubs().items():
        if not isinstance(node, ast.FunctionDef):
            continue
        doc = ast.get_docstring(node) or ""
        if "NDArray" in ast.unparse(node.returns or ast.Constant(None)):
            arrays += 1
            assert SHAPE.search(doc), name
            dimensionless = {"MeshCycle.pairs_in_contact", "Kurtogram.kurtosis", "Library.indicator"}
            in_class = ast.get_docstring(stubs()[name.split(".")[0]]) or ""
            assert name in dimensionless or UNITS.search(doc) or "in the samples' unit" in in_class, name
        for argument in [*node.args.args, *node.args.kwonlyargs]:
            if "ArrayLike" in ast.unparse(argument.annotation or ast.Constant(None)):
                at = re.search(rf"\b{argument.arg}(:|`` has)", doc)
                entry = re.split(r"\n {4}(?=\w)|\n\n", doc[at.start() :])[0] if at else ""
                assert SHAPE.search(" ".join(entry.split())), f"{name}: {argument.arg}"
                arrays += 1
    assert arrays > 40


def test_native_functions_with_arguments_state_their_errors():
    for name, node in stubs().items():
        if isinstance(node, ast.FunctionDef) and [each for each in node.args.args if each.arg != "self"]:
            assert "Raises:\n" in (ast.get_docstring(node) or ""), name


def test_the_page_names_everything_public():
    page = PAGE.read_text()
    missing = [name for name in PUBLIC if not re.search(rf"\b{name}\b", page)]
    missing += [
        f"{name}.{method}"
        for name, cls in CLASSES.items()
        for method in methods(cls)
        if not re.search(rf"\b{method}\b", page)
    ]
    assert not missing


def test_each_function_and_method_has_an_executed_example():
    code = "\n".join(examples(PAGE))
    functions = [name for name, each in PUBLIC.items() if not inspect.isclass(each)]
    assert len(functions) > 10
    missing = [name for name in functions if f"flankwatch.{name}(" not in code]
    missing += [
        f"{name}.{method}"
        for name, cls in CLASSES.items()
        for method in methods(cls)
        if not re.search(rf"\.{method}\(", code)
    ]
    assert not missing
