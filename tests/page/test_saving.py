"""What a page saves is a study that reads back as it was."""

import pytest
import torch
from page_cases import HOSTILE, PLANE, plane, space

from torcharm.page import state as page
from torcharm.page.answers import answer
from torcharm.page.saving import load, save, study_text
from torcharm.study import evaluate_study, load_study, parse_study


@pytest.mark.parametrize("make", [plane, space])
def test_designs_of_all_arms_read_back(tmp_path, make):
    state = page.with_value(make(), 0, "distance", 0.042)
    out = tmp_path / "saved.toml"
    save(state, out)
    read = load_study(out)
    assert [arm.name for arm in read.arms] == [arm.name for arm in state.study.arms]
    torch.testing.assert_close(read.arms[0].design.max_pressure, page.design_of(state).max_pressure)
    assert answer(load(state, out)).found.tip_error.item() == pytest.approx(
        answer(state).found.tip_error.item(), abs=1e-8
    )
    assert len(read.tasks) == len(state.study.tasks)


def test_a_task_that_was_changed_is_added_under_a_name_of_its_own(tmp_path):
    state = page.with_payload(page.with_tip(plane(), 0, 0.7), 0.02)
    read = parse_study(study_text(state, tmp_path / "saved.toml"))
    assert [task.name for task in read.tasks] == [f"bend {HOSTILE}", f"bend {HOSTILE}, explored"]
    assert read.tasks[1].arms == (f"mine {HOSTILE}",)
    (result,) = [one for one in evaluate_study(read) if one.task is read.tasks[1]]
    assert result.attainability.tip_error.item() == pytest.approx(answer(state).found.tip_error.item(), abs=1e-8)
    again = page.with_tip(page.with_task(page.opened(read), 1), 0, 0.1)
    names = [task.name for task in parse_study(study_text(again, tmp_path / "saved.toml")).tasks]
    assert names == [f"bend {HOSTILE}", f"bend {HOSTILE}, explored", f"bend {HOSTILE}, explored 2"]


def test_what_was_saved_opens_at_the_task_that_was_explored(tmp_path):
    out = tmp_path / "saved.toml"
    state = page.with_tip(plane(), 0, 0.7)
    save(state, out)
    again = load(state, out)
    assert again.named_task.name == f"bend {HOSTILE}, explored"
    assert again.tip == state.tip
    assert answer(again).found.tip_error.item() == pytest.approx(answer(state).found.tip_error.item(), abs=1e-8)
    further = page.with_tip(again, 0, 0.1)
    save(further, out)
    assert load(further, out).tip == further.tip


def test_what_was_saved_opens_at_the_same_arm(tmp_path):
    out = tmp_path / "saved.toml"
    state = page.with_arm(plane(), 1)
    save(state, out)
    assert load(state, out).named_arm.name == f"other {HOSTILE}"
    out.write_text(PLANE.replace("other", "third").replace("mine", "fourth"))
    assert load(state, out).arm == 0


def test_what_is_no_study_is_said(tmp_path):
    with pytest.raises(ValueError, match="cannot be read"):
        load(plane(), tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("name = 1")
    with pytest.raises(ValueError, match="arm: missing"):
        load(plane(), tmp_path / "bad.toml")
