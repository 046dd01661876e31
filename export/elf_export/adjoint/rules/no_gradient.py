"""The ops that pass no gradient on: constant almost everywhere, random, or blind to the image's values.

An op that only gives integers or booleans needs no entry, those stop the gradient by themselves; it is here
so that a reader finds it.
"""

from __future__ import annotations

from elf_export.adjoint.registry import no_gradient

no_gradient(
    "Shape", "Size", "NonZero", "ArgMax", "ArgMin",
    "Equal", "Greater", "GreaterOrEqual", "Less", "LessOrEqual",
    "And", "Or", "Not", "Xor", "IsNaN", "IsInf", "NonMaxSuppression",
    "Floor", "Ceil", "Round", "Sign", "Hardmax", "OneHot",
    "Constant", "ConstantOfShape", "EyeLike", "Range", "Bernoulli", "Multinomial",
    "RandomNormal", "RandomNormalLike", "RandomUniform", "RandomUniformLike",
)  # fmt: skip
