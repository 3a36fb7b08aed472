"""What numba does before LLVM for every function, and need not: it leaves code and types as they are.

Each of these replaces a function of the tried versions of numba by one with the same answer.
"""

from __future__ import annotations

from functools import cache
from typing import Any


def shorten() -> None:
    """Let numba compare options, list variables and look for their ends only as often as it must."""
    _compare_options_by_value()
    _remember_operators()
    _list_variables_by_class()
    _find_ends_when_asked_for()
    _report_no_locks()


def _compare_options_by_value() -> None:
    """numba looks a function up by the options of its caller, and reads all forty of each to hash and to compare."""
    from numba.core.targetconfig import TargetConfig

    @cache
    def defaults(kind: Any) -> dict[str, Any]:
        return {name: option.default for name, option in kind.options.items()}

    def values(config: Any) -> dict[str, Any]:
        return defaults(config.__class__) | config._values

    def equal(config: Any, other: Any) -> Any:
        if not isinstance(other, TargetConfig):
            return NotImplemented
        same = type(config) is type(other) and config._values == other._values
        return same or config.values() == other.values()

    @cache
    def digest(kind: Any) -> int:
        return hash(tuple(sorted(kind.options)))  # of their names: numba's own is no other

    TargetConfig.values = values  # type: ignore[method-assign,unused-ignore]
    TargetConfig.__eq__ = equal  # type: ignore[method-assign,assignment,unused-ignore]
    TargetConfig.__hash__ = lambda config: digest(config.__class__)  # type: ignore[method-assign,unused-ignore]


def _remember_operators() -> None:
    """An operator of the same numbers has the same type each time; numba tries ten templates for it each time."""
    from numba.core import types

    whole = types.Function.get_call_type
    number = (types.Number, types.Boolean)

    def get_call_type(function: Any, context: Any, args: Any, named: Any) -> Any:
        if named or not all(isinstance(kind, number) for kind in args):
            return whole(function, context, args, named)
        seen = function.__dict__.setdefault("_seen", {})
        signature = seen.get((context, args))
        if signature is None:
            signature = whole(function, context, args, named)
            # what is compiled for it depends on the caller's options; what is built in does not
            if signature is not None and function.get_impl_key(signature) is function.typing_key:
                seen[context, args] = signature
        return signature

    types.Function.get_call_type = get_call_type  # type: ignore[method-assign,assignment,unused-ignore]


def _list_variables_by_class() -> None:
    """What an attribute of an instruction is depends on its class; numba asks five times for each."""
    from numba.core import ir

    @cache
    def sort_of(kind: Any) -> type[Any] | None:
        return next((base for base in (ir.Var, ir.Inst, list, tuple, dict) if issubclass(kind, base)), None)

    def gather(value: Any, variables: list[Any]) -> None:
        sort = sort_of(value.__class__)
        if sort is None:
            return
        if sort is ir.Var:
            variables.append(value)
        elif sort is ir.Inst:
            variables.extend(value.list_vars())
        else:
            for item in value.values() if sort is dict else value:
                gather(item, variables)

    def list_variables(_: Any, value: Any) -> list[Any]:
        variables: list[Any] = []
        gather(value, variables)
        return variables

    ir.Inst._rec_list_vars = list_variables  # type: ignore[method-assign,unused-ignore]


def _find_ends_when_asked_for() -> None:
    """After each of ten passes numba reckons where each variable's life ends; generators and object mode ask for it."""
    from numba.core import postproc, transforms

    whole = postproc.PostProcessor.run

    def run(processor: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
        function = processor.func_ir
        if function.is_generator or "literal_unroll" in function.func_id.code.co_names:
            whole(processor, emit_dels, extend_lifetimes)
            return
        function.blocks = transforms.canonicalize_cfg(function.blocks)
        function.variable_lifetime = postproc.VariableLifetime(function.blocks)  # which reckons when it is asked
        function.generator_info = None
        if emit_dels:
            processor._insert_var_dels(extend_lifetimes)

    postproc.PostProcessor.run = run  # type: ignore[method-assign,unused-ignore]


def _report_no_locks() -> None:
    """numba measures how long LLVM is locked, at each of its calls, for a report that nobody reads."""
    from llvmlite.binding import ffi

    callbacks = ffi.lib._lock._cblist
    callbacks[:] = [pair for pair in callbacks if pair[0].__module__ != "numba.core.base"]
