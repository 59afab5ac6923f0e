"""The import graph of the package, read off the syntax trees; as a script it draws the layers.

python tools/import_graph.py                              layers and imports between packages
python tools/import_graph.py --write doc/architecture.md  renew the diagram in the document
python tools/import_graph.py --lines                      lines of code per package

Imports inside functions count; those under `if TYPE_CHECKING` do not, since they do not run.
"""

import argparse
import ast
from collections.abc import Iterator
from pathlib import Path

BEGIN_MARK = '<!-- layers: written by tools/import_graph.py -->'
END_MARK = '<!-- end of layers -->'
PACKAGE = Path(__file__).resolve().parents[1] / 'explore_slam'

# From the top to the bottom: a package may import its own layer's members only where they do not
# form a circle, and everything below. Single modules of the root are members of a layer too.
LAYERS = (
    ('cli',),
    ('live',),
    ('nodes',),
    ('studies',),
    ('results',),
    ('recording',),
    ('agent',),
    ('simulation',),
    ('messages',),
    ('slam', 'mapping', 'exploration', 'vehicle'),
    ('registration', 'vision'),
    ('settings', 'data', 'mounts', 'body', 'battery', 'sweeps', 'tags'),
    ('geometry', 'polyline', 'heap', 'compiled', 'failures', 'files'),
    ('environment',),
    ('errors',),
)


def package_of(module: str) -> str:
    """Return the member of a layer that a module belongs to, 'slam' for explore_slam.slam.x."""
    return module.split('.')[1] if '.' in module else ''


def modules() -> dict[str, Path]:
    """Return all modules of the package by dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob('*.py')):
        parts = path.relative_to(PACKAGE.parent).with_suffix('').parts
        found['.'.join(parts).removesuffix('.__init__')] = path
    return found


def _statements(tree: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Yield the import statements that run."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and 'TYPE_CHECKING' in ast.unparse(node.test):
            for other in node.orelse:
                yield from _statements(other)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        else:
            yield from _statements(node)


def imports_of(path: Path, known: dict[str, Path]) -> Iterator[str]:
    """Yield the dotted names that a module imports: modules of the package, or top-level others.

    `from explore_slam.a import b` is the module explore_slam.a.b where there is one.
    """
    tree = ast.parse(path.read_text(encoding='utf-8'))
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
            continue
        if node.level:
            raise ValueError(f'{path}:{node.lineno}: relative import')
        for name in node.names:
            module = f'{node.module}.{name.name}'
            yield module if module in known else str(node.module)


def graph() -> dict[str, set[str]]:
    """Return for each module of the package what it imports."""
    known = modules()
    return {module: set(imports_of(path, known)) for module, path in known.items()}


def circles(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected components of more than one member (Tarjan, 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(arrows.get(node, ())):
            if other not in arrows:
                continue
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            component = []
            while not component or component[-1] != node:
                component.append(stack.pop())
            if len(component) > 1:
                found.append(sorted(component))

    for node in sorted(arrows):
        if node not in index:
            visit(node)
    return found


def between_packages(arrows: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the arrows between members of layers."""
    found: dict[str, set[str]] = {}
    for module, targets in arrows.items():
        here = package_of(module)
        for target in targets:
            there = package_of(target) if target.startswith('explore_slam.') else ''
            if here and there and here != there:
                found.setdefault(here, set()).add(there)
    return found


def diagram() -> str:
    """Return the layers from the top to the bottom, and what each member imports."""
    arrows = between_packages(graph())
    present = {package_of(module) for module in modules()}
    order = [member for layer in LAYERS for member in layer]
    blocks = []
    for layer in LAYERS:
        lines = []
        for member in layer:
            if member in present:
                imported = sorted(arrows.get(member, ()), key=order.index)
                lines.append(f'{member:13s} -> {" ".join(imported)}'.removesuffix(' -> ').rstrip())
        blocks.append('\n'.join(lines))
    rule = '\n' + '-' * 13 + '\n'
    return rule.join(block for block in blocks if block)


def with_diagram(text: str) -> str:
    """Return a document with the diagram renewed between its two marks."""
    before, _, rest = text.partition(BEGIN_MARK)
    _, end, after = rest.partition(END_MARK)
    if not end:
        raise ValueError(f'expected {BEGIN_MARK} and {END_MARK}')
    return f'{before}{BEGIN_MARK}\n```\n{diagram()}\n```\n{END_MARK}{after}'


def main() -> None:
    """Print the diagram or renew it in a document; print lines of code per member."""
    parser = argparse.ArgumentParser(description='Draw the layers from the imports.')
    parser.add_argument(
        '--write', type=Path, metavar='FILE', help='renew the diagram in a document'
    )
    parser.add_argument('--lines', action='store_true', help='lines of code per package')
    arguments = parser.parse_args()
    if arguments.write:
        text = arguments.write.read_text(encoding='utf-8')
        arguments.write.write_text(with_diagram(text), encoding='utf-8')
    elif arguments.lines:
        counts: dict[str, int] = {}
        for module, path in modules().items():
            lines = len(path.read_text(encoding='utf-8').splitlines())
            counts[package_of(module)] = counts.get(package_of(module), 0) + lines
        for layer in LAYERS:
            for member in layer:
                if member in counts:
                    print(f'{member:13s}{counts[member]:6d}')
    else:
        print(diagram())


if __name__ == '__main__':
    main()
