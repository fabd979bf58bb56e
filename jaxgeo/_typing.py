"""Type aliases for array shapes. Functions require exact shapes; fields of records may carry batch axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Int8, Num

Scalar: TypeAlias = Float[Array, ""]
Pixel: TypeAlias = Float[Array, "2"]
Vector3: TypeAlias = Float[Array, "3"]
Matrix3: TypeAlias = Float[Array, "3 3"]
Flag: TypeAlias = Bool[Array, ""]
Index: TypeAlias = Int[Array, ""]
StatusCode: TypeAlias = Int8[Array, ""]
StatusCodes: TypeAlias = Int8[Array, "..."]

# One item or a batch, for elementwise functions.
Numbers: TypeAlias = Float[Array, "..."]
Flags: TypeAlias = Bool[Array, "..."]
Indices: TypeAlias = Int[Array, "..."]

# Fields of records: one item, or a batch for `vmap`; public functions promote plain numbers. A static type checker
# cannot follow that promotion (it keeps a union with `complex`), so it sees `Any`.
if TYPE_CHECKING:
    ScalarLike: TypeAlias = Any
    ScalarField: TypeAlias = Any
    PixelField: TypeAlias = Any
    Vector3Field: TypeAlias = Any
    Matrix3Field: TypeAlias = Any
    PostsField: TypeAlias = Any
    VoidField: TypeAlias = Any
    ExtentField: TypeAlias = Any
    StatusField: TypeAlias = Any
    FlagField: TypeAlias = Any
    IndexField: TypeAlias = Any
else:
    ScalarLike: TypeAlias = Num[ArrayLike, ""]
    ScalarField: TypeAlias = Num[ArrayLike, "..."]
    PixelField: TypeAlias = Num[ArrayLike, "... 2"]
    Vector3Field: TypeAlias = Num[ArrayLike, "... 3"]
    Matrix3Field: TypeAlias = Num[ArrayLike, "... 3 3"]
    PostsField: TypeAlias = Num[ArrayLike, "... rows cols"]
    VoidField: TypeAlias = Bool[ArrayLike, "... rows cols"]
    ExtentField: TypeAlias = Int[ArrayLike, "... 2"]
    StatusField: TypeAlias = Int8[ArrayLike, "..."]
    FlagField: TypeAlias = Bool[ArrayLike, "..."]
    IndexField: TypeAlias = Int[ArrayLike, "..."]
