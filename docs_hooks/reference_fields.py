"""Griffe extension for equinox modules: constructors from fields, descriptions of fields from comments."""

import griffe


class Fields(griffe.Extension):
    """Convert fields of classes to the form that `mkdocstrings` renders."""

    def on_attribute_instance(self, *, attr, **_) -> None:
        """Take a field's trailing comment as its description: `fx: Float[Array, "steps"]  # force along x`."""
        if attr.docstring is None and attr.parent.is_class and attr.lineno and attr.lineno == attr.endlineno:
            line = attr.lines_collection[attr.filepath][attr.lineno - 1]
            _, mark, comment = line.partition("  # ")
            if mark and not comment.startswith(("pyright", "type:", "noqa")):
                attr.docstring = griffe.Docstring(comment, lineno=attr.lineno, parent=attr)

    def on_package(self, *, pkg, **_) -> None:
        """Give classes with documented arguments a constructor made of fields; remove it from other dataclasses."""
        for cls in list(_classes(pkg)):
            if "Args:" not in (cls.docstring.value if cls.docstring else ""):
                if "dataclass" in cls.labels and "__init__" in cls.members:
                    cls.del_member("__init__")
            elif "__init__" not in cls.members:
                parameters = [griffe.Parameter("self", kind=griffe.ParameterKind.positional_or_keyword)]
                parameters += [_parameter(attr) for attr in _fields(cls)]
                parameters.sort(key=lambda p: p.kind == griffe.ParameterKind.keyword_only)
                cls.set_member("__init__", griffe.Function("__init__", parameters=griffe.Parameters(*parameters)))


def _classes(module):
    for member in module.members.values():
        if member.is_alias:
            continue
        if member.is_class:
            yield member
        elif member.is_module:
            yield from _classes(member)


def _fields(cls):
    inherited = [attr for base in cls.resolved_bases for attr in _fields(base)]
    own = [a for a in cls.members.values() if a.is_attribute and a.annotation and "property" not in a.labels]
    return [*(attr for attr in inherited if attr.name not in cls.members), *own]


def _parameter(attr):
    kind, value = griffe.ParameterKind.positional_or_keyword, attr.value
    if isinstance(value, griffe.ExprCall) and str(value.function) == "eqx.field":
        given = {a.name: a.value for a in value.arguments if isinstance(a, griffe.ExprKeyword)}
        kind = griffe.ParameterKind.keyword_only if str(given.get("kw_only")) == "True" else kind
        value = given.get("default")
    return griffe.Parameter(attr.name, annotation=attr.annotation, kind=kind, default=value)
