"""Message packages compiled for the image that this runs in; part of a build stage of `robotkube image build`.

    compile_messages.py wheels               the wheels that generating needs, in the versions of this image
    compile_messages.py compile MSGS TARGET  MSGS/PACKAGE/msg/*.msg as libraries, Python and definitions below TARGET
    compile_messages.py check MSGS           each message written and read by this image's Python

What CMake does in a ROS workspace: definitions become IDL, type hashes, C structures, support for the middleware and
for introspection, and Python classes; each generator has a folder of its own, since names of files repeat.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
import sysconfig
from collections.abc import Iterable, Sequence
from graphlib import TopologicalSorter
from importlib.metadata import distributions
from pathlib import Path

ONLY_FOR_BUILDS = ("empy==4.2.1", "lark-parser==0.12.0")
C, PYTHON, SUPPORT = "rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c"
DDS, INTROSPECTION = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
HASHES = "rosidl_generator_type_description"
VISIBILITY = {C: "rosidl_generator_c", DDS: DDS, INTROSPECTION: INTROSPECTION}
RUNTIME = {
    C: ("rosidl_runtime_c", "rcutils"),
    DDS: ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_fastrtps_cpp", "fastcdr"),
    INTROSPECTION: ("rosidl_typesupport_introspection_c",),
    SUPPORT: ("rosidl_typesupport_c",),
    PYTHON: (),
}
OTHER_PACKAGE = re.compile(r"^\s*(\w+)/\w+", re.MULTILINE)

prefix = Path(sys.prefix)


def wheels() -> list[str]:
    """The requirements, a line each."""
    known = {str(one.metadata["Name"]).lower().replace("_", "-"): one.version for one in distributions()}
    chosen = [name for name in known if name == "numpy" or (name.startswith("ros-") and "jazzy" not in name)]
    return [*(f"{name}=={known[name]}" for name in sorted(chosen)), *ONLY_FOR_BUILDS]


def messages(package: Path) -> list[str]:
    """The names of a package's messages."""
    return sorted(path.stem for path in (package / "msg").glob("*.msg"))


def in_order(packages: Iterable[Path]) -> list[Path]:
    """Packages, each after those whose messages it uses."""
    known = {package.name: package for package in packages}
    graph = {}
    for name, package in sorted(known.items()):
        texts = [path.read_text(encoding="utf-8") for path in (package / "msg").glob("*.msg")]
        used = {other for text in texts for other in OTHER_PACKAGE.findall(text)}
        graph[name] = sorted((used & known.keys()) - {name})
    return [known[name] for name in TopologicalSorter(graph).static_order()]


class Package:
    """One package, generated and compiled below `work`, its result below `target`."""

    def __init__(self, source: Path, work: Path, target: Path) -> None:
        self.name = source.name
        self.source = source
        self.work = work
        self.target = target
        self.names = messages(source)

    def folder(self, generator: str) -> Path:
        """What a generator writes."""
        path = self.work / generator / self.name
        (path / "msg").mkdir(parents=True, exist_ok=True)
        return path

    def generate(self) -> None:
        """Write all sources."""
        from rosidl_adapter.msg import convert_msg_to_idl
        from rosidl_generator_c import generate_c
        from rosidl_generator_py import generate_py
        from rosidl_generator_type_description import generate_type_hash
        from rosidl_typesupport_c import generate_c as generate_support
        from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
        from rosidl_typesupport_introspection_c import generate_c as generate_introspection

        for name in self.names:
            convert_msg_to_idl(self.source, self.name, Path("msg") / f"{name}.msg", self.folder("idl") / "msg")
        generate_type_hash(self._arguments(HASHES))
        generate_c(self._arguments(C))
        generate_typesupport_fastrtps_c(self._arguments(DDS))
        generate_introspection(self._arguments(INTROSPECTION))
        generate_support(self._arguments(SUPPORT), [DDS, INTROSPECTION])
        generate_py(self._arguments(PYTHON), [SUPPORT])
        for generator, word in VISIBILITY.items():
            self._visibility(generator, f"{word}__visibility_control.h")

    def _arguments(self, generator: str) -> str:
        """The file with a generator's arguments."""
        out, idl, hashes = self.folder(generator), self.folder("idl"), self.folder(HASHES)
        known = [path.parent for path in (prefix / "share").glob("*/msg")]
        known += [path for path in (self.work / HASHES).iterdir() if path.name != self.name]
        document = {
            "package_name": self.name,
            "output_dir": str(out),
            "template_dir": str(prefix / "share" / generator / "resource"),
            "idl_tuples": [f"{idl}:msg/{name}.idl" for name in self.names],
            "ros_interface_files": [str(self.source / "msg" / f"{name}.msg") for name in self.names],
            "ros_interface_dependencies": [],
            "target_dependencies": [],
            "type_description_tuples": [f"msg/{name}.idl:{hashes}/msg/{name}.json" for name in self.names],
            "include_paths": [f"{path.name}:{path}" for path in known],
        }
        file = self.work / f"{generator}-{self.name}.json"
        file.write_text(json.dumps(document), encoding="utf-8")
        return str(file)

    def _visibility(self, generator: str, file: str) -> None:
        text = (prefix / "share" / generator / "resource" / f"{file}.in").read_text(encoding="utf-8")
        text = text.replace("@PROJECT_NAME_UPPER@", self.name.upper()).replace("@PROJECT_NAME@", self.name)
        (self.folder(generator) / "msg" / file).write_text(text, encoding="utf-8")

    def compile(self) -> None:
        """Libraries, Python package and definitions."""
        for generator, runtime in RUNTIME.items():
            sources = self._sources(generator)
            own = [] if generator == C else [f"{self.name}__{C}"]
            self._link(self._library(generator), sources, [*own, *runtime, *self._others(generator)])
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        package = self.target / "lib" / version / "site-packages" / self.name
        (package / "msg").mkdir(parents=True, exist_ok=True)
        (package / "__init__.py").write_text("", encoding="utf-8")
        for path in (self.folder(PYTHON) / "msg").glob("*.py"):
            (package / "msg" / path.name).write_bytes(path.read_bytes())
        extension = package / f"{self.name}_s__{SUPPORT}{sysconfig.get_config_var('EXT_SUFFIX')}"
        entry = self.folder(PYTHON) / f"_{self.name}_s.ep.{SUPPORT}.c"
        self._link(extension, [entry], [f"{self.name}__{generator}" for generator in (PYTHON, SUPPORT, C)])
        definitions = self.target / "share" / self.name / "msg"
        definitions.mkdir(parents=True, exist_ok=True)
        for name in self.names:
            (definitions / f"{name}.msg").write_bytes((self.source / "msg" / f"{name}.msg").read_bytes())

    def _library(self, generator: str) -> Path:
        return self.target / "lib" / f"lib{self.name}__{generator}.so"

    def _sources(self, generator: str) -> list[Path]:
        folder = self.folder(generator)
        if generator == PYTHON:
            return sorted((folder / "msg").glob("*_s.c"))
        return sorted([*folder.rglob("*.c"), *folder.rglob("*.cpp")])

    def _others(self, generator: str) -> list[str]:
        """The same library of every other package; the linker takes what is needed."""
        paths = [*(prefix / "lib").glob(f"lib*__{generator}.so"), *(self.target / "lib").glob(f"lib*__{generator}.so")]
        return sorted({path.name[3:-3] for path in paths} - {f"{self.name}__{generator}"})

    def _link(self, result: Path, sources: Sequence[Path], libraries: Sequence[str]) -> None:
        result.parent.mkdir(parents=True, exist_ok=True)
        objects = [self._object(source) for source in sources]
        folders = [f"-L{self.target / 'lib'}", f"-L{prefix / 'lib'}"]
        needed = ["-Wl,--as-needed", *(f"-l{name}" for name in libraries)]
        run("g++", "-shared", "-s", f"-Wl,-soname,{result.name}", "-o", str(result), *objects, *folders, *needed)

    def _object(self, source: Path) -> str:
        import numpy

        folders = [self.work / generator for generator in RUNTIME]
        folders += [path for path in sorted((prefix / "include").iterdir()) if path.is_dir()]
        folders += [prefix / "include", Path(sysconfig.get_paths()["include"]), Path(numpy.get_include())]
        compiler = ["g++", "-std=c++17"] if source.suffix == ".cpp" else ["gcc", "-std=c11"]
        result = f"{source}.o"
        run(*compiler, "-O2", "-fPIC", "-w", *(f"-I{path}" for path in folders), "-c", str(source), "-o", result)
        return result


def run(*command: str) -> None:
    """Run a program; what it says is shown."""
    done = subprocess.run(command, check=False)
    if done.returncode:
        sys.exit(f"{command[0]} ended with code {done.returncode}")


def compile_all(packages: Path, target: Path) -> None:
    """Every package of the folder."""
    work = target.parent / "generated"
    os.environ.setdefault("AMENT_PREFIX_PATH", str(prefix))
    for source in in_order(path for path in packages.iterdir() if path.is_dir()):
        package = Package(source.resolve(), work, target)
        package.generate()
        package.compile()


def check(packages: Path) -> None:
    """SystemExit when a message does not come back as it went."""
    from rclpy.serialization import deserialize_message, serialize_message

    for package in sorted(path for path in packages.iterdir() if path.is_dir()):
        module = importlib.import_module(f"{package.name}.msg")
        for name in messages(package):
            kind = getattr(module, name)
            if deserialize_message(serialize_message(kind()), kind) != kind():
                sys.exit(f"{package.name}/msg/{name}: is not read as it was written")


if __name__ == "__main__":
    if sys.argv[1] == "wheels":
        print("\n".join(wheels()))
    elif sys.argv[1] == "compile":
        compile_all(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        check(Path(sys.argv[2]))
