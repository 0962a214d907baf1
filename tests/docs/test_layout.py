"""Layout: levels of packages, imports that only point down, class names, test files, names in docs/developing.md."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "jaxwhisker"
DEVELOPING = (ROOT / "docs" / "developing.md").read_text("utf-8")
LONGEST = 400  # lines of a file
API = {"__init__", "__main__"}  # the package root, which only collects names
ELSEWHERE = {  # packages whose __init__.py defines functions, and the files that test these
    "_explore": "explore/test_hosts.py",  # starts a host
    "cli": "cli/test_main.py",  # the command that contains all others
    "plot": "base/test_suggest.py",  # completes and suggests names
}


def levels() -> dict[str, int]:
    """Level of every package, from the table in docs/developing.md."""
    table = DEVELOPING.split("| level | package | contents |")[1].split("\n\n")[0]
    rows = re.findall(r"^\| (\d+) \| ([^|]+) \|", table, re.MULTILINE)
    return {name: int(level) for level, names in rows for name in re.findall(r"`(\w+)/`", names)}


def files() -> list[Path]:
    return [
        file
        for file in sorted(PACKAGE.rglob("*.py"))
        if file.relative_to(PACKAGE).parts[0].removesuffix(".py") not in API
    ]


def name_of(file: Path) -> str:
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(file: Path) -> list[str]:
    """Modules of the package that a file imports, at any depth of its code; "" is the package root."""
    modules = {name_of(other) for other in files()}
    found = []
    for statement in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(statement, ast.Import):
            found += [
                alias.name.partition("jaxwhisker")[2].strip(".")
                for alias in statement.names
                if alias.name.startswith("jaxwhisker")
            ]
        elif isinstance(statement, ast.ImportFrom) and (statement.module or "").partition(".")[0] == "jaxwhisker":
            base = (statement.module or "").removeprefix("jaxwhisker").strip(".")
            for alias in statement.names:
                full = f"{base}.{alias.name}".strip(".")
                found.append(full if full in modules else base)
    return found


def test_every_package_has_a_level():
    packages = {file.relative_to(PACKAGE).parts[0] for file in files()}
    assert set(levels()) == packages


@pytest.mark.parametrize("file", files(), ids=name_of)
def test_imports_point_down(file):
    floor, own = levels(), name_of(file).partition(".")[0]
    for module in imports(file):
        package = module.partition(".")[0]
        assert package, "imports the package root"
        assert package == own or floor[package] < floor[own], module


def test_imports_have_no_cycles():
    graph = {name_of(file): {module for module in imports(file) if module != name_of(file)} for file in files()}
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " -> ".join((*trail, module))
        if module not in done:
            for other in sorted(graph.get(module, ())):
                visit(other, (*trail, module))
            done.add(module)

    for module in graph:
        visit(module, ())


def test_a_class_name_stands_in_one_module():
    """One word means one thing: no two modules have classes of the same name, leading underscores aside."""
    modules: dict[str, set[str]] = {}
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef):
                modules.setdefault(node.name.lstrip("_"), set()).add(name_of(file))
    assert {name: sorted(of) for name, of in modules.items() if len(of) > 1} == {}


def test_files_are_short():
    long = {name_of(file): count for file in files() if (count := len(file.read_text("utf-8").splitlines())) > LONGEST}
    assert not long


def test_files_on_the_way_from_a_scan_to_the_equations_exist():
    way = DEVELOPING.split("## From a scan to the equations")[1].split("```")[1]
    named = re.findall(r"\b_\w+/\w+\.py", way)
    assert named
    assert [name for name in named if not (PACKAGE / name).exists()] == []


def test_modules_that_pages_name_exist():
    pages = [ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
    named = {
        page.name: re.findall(r"`((?:_\w+|plot|film|thesis|cli)/\w+\.py)`", page.read_text("utf-8")) for page in pages
    }
    assert named["developing.md"]
    missing = {(page, name) for page, names in named.items() for name in names if not (PACKAGE / name).exists()}
    assert missing == set()


@pytest.mark.parametrize(
    "page", ["README.md", "CONTRIBUTING.md", *(f"docs/{p.name}" for p in sorted((ROOT / "docs").glob("*.md")))]
)
def test_files_of_the_repository_that_a_page_names_exist(page):
    text = (ROOT / page).read_text("utf-8")
    for name in set(
        re.findall(r"(?<![\w/.])((?:tests|benchmarks|docs|examples|notebooks|figures)/[\w/.-]+\.\w+)", text)
    ):
        assert (ROOT / name).exists(), name


def test_every_test_file_is_in_the_folder_of_a_package():
    """Test files are tests/<package>/test_<module>.py."""
    packages = {name.lstrip("_"): name for name in levels()}
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        assert file.parent.name in {*packages, "physics", "docs"}, file


MOST_FILES = 4  # in which a feature stands
ASKS = re.compile(r"if .*friction(_angle)? is (not )?None")


def additions() -> list[tuple[str, set[str]]]:
    """Examples of features and their files, from the table in docs/developing.md."""
    table = DEVELOPING.split("| to add | example | its files | what each holds |")[1].split("\n\n")[0]
    rows = [row.split("|")[2:4] for row in table.splitlines()[2:]]
    return [(example.strip(" `"), set(re.findall(r"`([^`]+)`", names))) for example, names in rows if "`" in example]


@pytest.mark.parametrize(("example", "names"), additions(), ids=[example for example, _ in additions()])
def test_a_feature_stands_in_few_files(example, names):
    word = re.compile(rf"(?<!\w){re.escape(example)}(?!\w)")
    holding = {str(file.relative_to(PACKAGE)) for file in PACKAGE.rglob("*.py") if word.search(file.read_text("utf-8"))}
    assert len(names) <= MOST_FILES
    assert holding == names


def test_the_march_leaves_friction_to_its_law():
    asking = {
        file.name
        for package in ("_path", "_plane")
        for file in (PACKAGE / package).glob("*.py")
        if ASKS.search(file.read_text("utf-8"))
    }
    # Compose laws, choose the steps of a flow, and check the energies of snaps, which only friction raises.
    assert asking == {"events.py", "law.py", "snap_flow.py", "gains.py"}


def test_every_module_with_functions_has_a_test_file():
    """That of a module is tests/<package>/test_<module>.py; modules of data classes and constants need none."""
    missing = []
    for file in files():
        package, _, module = name_of(file).partition(".")
        own = ROOT / "tests" / ELSEWHERE.get(name_of(file), f"{package.lstrip('_')}/test_{module.lstrip('_')}.py")
        tree = ast.walk(ast.parse(file.read_text("utf-8")))
        if any(isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) for node in tree):
            missing += [] if own.exists() else [name_of(file)]
    assert missing == []
