"""Tasks and mechanics as the paper has them: each element's wrench is taken at the element's start."""

from functools import partial

import torcharm as ta

paper_task = partial(ta.Task, wrench_at="start")
paper_equilibrium = partial(ta.solve_equilibrium, wrench_at="start")
paper_wrench = partial(ta.required_wrench, wrench_at="start")
