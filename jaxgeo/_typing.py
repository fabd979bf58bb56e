"""Names for array shapes. Functions are strict about them; fields of records may carry batch axes."""

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

# One item or a whole crowd, for functions that work element by element.
Numbers: TypeAlias = Float[Array, "..."]
Flags: TypeAlias = Bool[Array, "..."]
Indices: TypeAlias = Int[Array, "..."]

# Fields of records: one item, or a batch of them for `vmap`; plain numbers are promoted at the public doors. A static
# checker cannot follow that promotion (it sees a union with `complex` to the end), so to it they are `Any`.
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
