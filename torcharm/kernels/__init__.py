"""What `torch` does for a whole batch, element by element in machine code.

The same methods as `mechanics.march`, `_tracing`, `_descent`, `_boundary` and `_continuation.settle`, which are to be
read first: an element runs to its end before the next begins, so that small batches cost no calls. In double precision,
on the CPU, for actuators that `arms.known` lists and arms that do not shear. Arrays here are of one element, but for
those in `Arms` and what the outermost functions take: there the batch comes first.
"""
