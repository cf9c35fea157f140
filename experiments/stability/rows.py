"""What this experiment measures, a row each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One answer; errors are relative to max|H - w|.

    Attributes:
        group, scene, backend, dtype, metric: what was asked.
        value, reference: the sum over nodes or points [N].
        error: the largest of a node or point, at most 1; 1 if the answer is not finite or not converged. Of an
            impossible shape 0 if that is the answer.
        gradient_error: by how much the derivative of the sum is off, the worse of two directions, at most 1;
            None where it has none or the reference could not tell.
        finite, in_range, converged: what the library says; in_range is None for bare hulls.
        smooth: whether the sum has a derivative; at a kink its error is that from the one-sided ones. None
            where that is not known.
    """

    group: str
    scene: str
    backend: str
    dtype: str
    metric: str
    value: float
    reference: float
    error: float
    gradient_error: float | None
    finite: bool
    in_range: bool | None
    converged: bool
    smooth: bool | None
