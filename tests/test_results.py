"""What results look like at a prompt."""

import torcharm as ta


def test_results_print_as_shapes_and_counts():
    arm, load = ta.antagonistic_arm(), ta.sample_loads(3)
    task = ta.Task(ta.affine_curvature(0.5, 0.5, length=0.5, nodes=4), load)
    found = [
        ta.evaluate(arm, task),
        ta.wrench_hulls(arm, task.twists),
        ta.load_capacity(arm, task),
        ta.solve_equilibrium(arm, [1.0, 2.0, 3.0, 4.0], load, nodes=4),
        ta.predict_error(arm, task),
        ta.search_pressure(arm, task),
        ta.fit_pressure(arm, task),
    ]
    for one in found:
        assert repr(one).startswith(type(one).__name__ + "(")
        assert len(repr(one)) < 400
        assert "tensor(" not in repr(one)
    assert "converged (3,): 3 of 3" in repr(found[3])
