"""House rules that no reviewer should have to check by eye: who imports whom, lengths, forbidden calls and words."""

import ast
import re
import statistics
import subprocess
import sys
from functools import cache
from pathlib import Path

import jaxtyping
import pytest
import torch

from hashnerf.cameras import look_at
from hashnerf.rays import Rays

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("hashnerf", "worlds", "carff", "aerial2ground")
# Each room and the rooms it may import from (itself always).
ARROWS = {
    "hashnerf": set(),
    "worlds": {"hashnerf"},
    "carff": {"hashnerf", "worlds"},
    "aerial2ground": {"hashnerf", "worlds"},
    "scripts": {"hashnerf", "worlds", "carff", "aerial2ground"},
}
# One camera model and one image format in the whole house, but no learning in the synthetic worlds.
WORLDS_MAY_USE = {
    f"hashnerf.{name}"
    for name in ("cameras", "rays", "posed_images", "transforms_json", "errors", "image_files", "lens", "poses")
} | {"hashnerf.command_line", "hashnerf.worker_processes"}
IGNORED_FOLDERS = {"__pycache__", "runs", "build", ".git", ".venv", ".pytest_cache", ".ruff_cache", ".hypothesis"}


def own_files(root: Path) -> list[Path]:
    """Tracked and new files of the project, without what git ignores; without git, everything that is not generated."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listing = subprocess.run(command, cwd=root, capture_output=True, check=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return [path for path in walk(root) if path.parent != root / "data" or path.name == "README.md"]
    return sorted({root / name for name in listing.split("\0") if name and (root / name).is_file()})


def walk(folder: Path) -> list[Path]:
    """Files below a folder, without the folders that programs generate."""
    files: list[Path] = []
    for path in sorted(folder.iterdir()):
        if path.is_file() and not path.is_symlink():
            files.append(path)
        elif path.is_dir() and path.name not in IGNORED_FOLDERS and not path.name.endswith(".egg-info"):
            files += walk(path)
    return files


@cache
def python_files() -> dict[str, ast.Module]:
    """Every Python file of the project by its relative path, parsed."""
    paths = [path for path in own_files(ROOT) if path.suffix == ".py"]
    return {path.relative_to(ROOT).as_posix(): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def imported_modules(tree: ast.Module) -> set[str]:
    """Full names of the modules that a file imports, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide who imports whom"
            names |= {f"{node.module}.{alias.name}" if "." not in node.module else node.module for alias in node.names}
    return names


def wrong_imports(path: str, tree: ast.Module) -> list[str]:
    """Imports of a file that go against the arrows."""
    room = path.split("/")[0]
    wrong = []
    for name in imported_modules(tree):
        target = name.split(".")[0]
        if target in ARROWS and target != room and target not in ARROWS[room]:
            wrong.append(f"{path} imports {name}")
        if room == "worlds" and target == "hashnerf" and ".".join(name.split(".")[:2]) not in WORLDS_MAY_USE:
            wrong.append(f"{path} imports {name}")
    return wrong


def forbidden_calls(path: str, tree: ast.Module) -> list[str]:
    """Unsafe loading, hidden NaN, lenient loading and skipped tests in a file."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            modules = {alias.name for alias in node.names} | {getattr(node, "module", None)}
            found += sorted(modules & {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal"})
        elif isinstance(node, ast.Attribute):
            name = ast.unparse(node)
            if name in {"torch.load", "yaml.load", "yaml.unsafe_load", "yaml.full_load"}:
                found.append(name)
            if node.attr == "nan_to_num" or re.fullmatch(r"pytest\.(mark\.)?(skip|skipif|xfail|importorskip)", name):
                found.append(name)
        elif isinstance(node, ast.Call):
            switches = {(key.arg, ast.unparse(key.value)) for key in node.keywords}
            called = ast.unparse(node.func)
            if ("allow_pickle", "True") in switches or (("strict", "False") in switches and called != "zip"):
                found.append(ast.unparse(node))
    return [f"{path}: {name}" for name in found]


def test_imports_follow_the_arrows():
    wrong = []
    for path, tree in python_files().items():
        if path.split("/")[0] in ARROWS:
            wrong += wrong_imports(path, tree)
    assert not wrong


@pytest.mark.parametrize(
    ("path", "source", "count"),
    [
        ("hashnerf/a.py", "import worlds", 1),
        ("hashnerf/a.py", "def f():\n    from carff import mdn", 1),
        ("hashnerf/a.py", "from hashnerf.rays import Rays\nimport numpy", 0),
        ("worlds/a.py", "from hashnerf.cameras import Cameras\nfrom hashnerf import rays", 0),
        ("worlds/a.py", "from hashnerf.field import Field", 1),
        ("worlds/a.py", "from hashnerf import field", 1),
        ("carff/a.py", "import worlds.scene\nfrom hashnerf.field import Field", 0),
        ("carff/a.py", "import aerial2ground.bridge", 1),
        ("aerial2ground/a.py", "from carff.mdn import Mdn", 1),
        ("carff/a.py", "import scripts.demo", 1),
    ],
)
def test_the_arrow_check_sees_wrong_imports(path, source, count):
    assert len(wrong_imports(path, ast.parse(source))) == count


def test_hashnerf_command_line_starts_without_torch():
    code = "import sys, hashnerf.command_line; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


def test_files_stay_short():
    lengths = {path: len((ROOT / path).read_text(encoding="utf-8").splitlines()) for path in python_files()}
    assert not {path: length for path, length in lengths.items() if length > 400}
    assert not {path: length for path, length in lengths.items() if path.startswith("scripts/") and length > 80}
    rooms = [length for path, length in lengths.items() if path.split("/")[0] in PACKAGES]
    assert statistics.median(rooms) < 200


def test_k30_k31_no_unsafe_calls_and_no_skipped_tests(numeric_row):
    hits = [hit for path, tree in python_files().items() for hit in forbidden_calls(path, tree)]
    print(hits)
    for row in ("K30", "K31"):
        numeric_row(row, f"{len(python_files())} files: pickle, torch.load and their like", len(hits))


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import load",
        "torch.load(path)",
        "yaml.load(text, Loader=yaml.Loader)",
        "np.load(path, allow_pickle=True)",
        "torch.nan_to_num(x)",
        "x.nan_to_num()",
        "model.load_state_dict(state, strict=False)",
        "@pytest.mark.skip\ndef test_a(): pass",
        "@pytest.mark.xfail(reason='later')\ndef test_a(): pass",
        "pytest.importorskip('carla')",
    ],
)
def test_the_call_check_sees_each_unsafe_call(source):
    assert len(forbidden_calls("a.py", ast.parse(source))) == 1


def test_no_machine_paths_and_no_registry_hosts():
    folders = "|".join(("work", "home", "root", "Users", "tmp"))
    hosts = "|".join(
        re.escape(host) for host in ("pypi" + ".org", "pythonhosted" + ".org", "download.pytorch" + ".org")
    )
    needles = re.compile(rf"(?<![\w.}}\])])/({folders})/|{hosts}")
    found = []
    for path in own_files(ROOT):
        data = path.read_bytes()
        if b"\0" in data:
            continue  # a picture or another binary file
        for number, line in enumerate(data.decode("utf-8", errors="replace").splitlines(), 1):
            if needles.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:80]}")
    assert not found


def test_tests_mirror_the_packages():
    files = set(python_files())
    modules = {path for path in files if path.split("/")[0] in PACKAGES and not path.endswith("__init__.py")}
    named = (path for path in files if path.startswith("tests/") and path.split("/")[1] in PACKAGES)
    tests = {path for path in named if path.split("/")[-1].startswith("test_")}
    homeless = [path for path in tests if not any(belongs_to(path, module) for module in modules)]
    public = [path for path in modules if has_public_names(python_files()[path])]
    untested = [module for module in public if not any(belongs_to(path, module) for path in tests)]
    assert not homeless, "test files without a module of that name"
    assert not untested, "modules with public functions but without a test file"


def belongs_to(test: str, module: str) -> bool:
    """`tests/room/test_name.py` belongs to `room/name.py`; so does `test_name_aspect.py` when one file is too long."""
    folder, _, name = module.removesuffix(".py").rpartition("/")
    stem = test.removeprefix(f"tests/{folder}/test_").removesuffix(".py")
    return stem == name or stem.startswith(f"{name}_")


def has_public_names(tree: ast.Module) -> bool:
    """Whether a module defines a function or class meant for others."""
    kinds = (ast.FunctionDef, ast.ClassDef)
    return any(isinstance(node, kinds) and not node.name.startswith("_") for node in tree.body)


def test_shapes_are_checked_in_tests():
    """The canary: were the type checker off, these wrong shapes would pass or fail with another error."""
    with pytest.raises(jaxtyping.TypeCheckError):
        Rays(origins=torch.zeros(4, 3), directions=torch.zeros(5, 3))
    with pytest.raises(jaxtyping.TypeCheckError):
        look_at(torch.zeros(2), torch.ones(3))


def test_own_files_without_git(tmp_path):
    for name in (
        "hashnerf/a.py",
        "runs/x/metrics.jsonl",
        ".venv/b.py",
        "data/big.png",
        "data/README.md",
        "x.egg-info/P",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    found = {path.relative_to(tmp_path).as_posix() for path in own_files(tmp_path)}
    assert found == {"hashnerf/a.py", "data/README.md"}
