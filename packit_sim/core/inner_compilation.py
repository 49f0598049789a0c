"""A compiler for kernels that only other kernels call: no machine code of their own.

numba optimizes each function and makes machine code of it, together with all that it calls, and
then does both again for each function that calls it. Where nobody else calls the inner function,
the first time is wasted. This is the one place that replaces private steps of numba;
`tests/test_hooks.py` lists the versions with which it was tried.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder


class InnerCompiler(CompilerBase):  # type: ignore[misc] # numba's own hints are not read
    """numba's compiler, which leaves optimization and machine code to the kernels that call."""

    def define_pipelines(self) -> list[Any]:
        """Return numba's own steps, which add to code that is only linked."""
        state = self.state
        state.library = _LinkedCode(state.targetctx.codegen(), state.func_id.func_qualname)
        return [DefaultPassBuilder.define_nopython_pipeline(state)]


class _LinkedCode(JITCodeLibrary):  # type: ignore[misc]
    """LLVM's code of a kernel and of those that it calls, for linking."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return that of no function: Python can't call a kernel without machine code."""
        return 0

    @property
    def codegen(self) -> _WithoutEnvironments:
        """The generator of code."""
        return _WithoutEnvironments(self._codegen)


class _WithoutEnvironments:
    """A generator of code that sets no Python objects: code without machine code has none."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, env: object) -> None:
        """Do nothing."""
