import pytest

from percept.workers import InProcess, Job


def test_jobs_are_done_in_order_each_taken_when_the_one_before_is_handed_back():
    seen = []

    def jobs():
        for number in range(3):
            seen.append(f"take {number}")
            yield Job(str(number), number)

    for answer in InProcess().map(lambda number: number**2, jobs()):
        seen.append(f"{answer.job.key}: {answer.result}")
    assert seen == ["take 0", "0: 0", "take 1", "1: 1", "take 2", "2: 4"]


def test_an_error_is_its_job_s_and_the_others_go_on():
    answers = list(InProcess().map(lambda x: 1 / x, [Job("a", 2), Job("b", 0), Job("c", 4)]))
    assert [answers[0].result, answers[2].result] == [0.5, 0.25]
    assert isinstance(answers[1].result, ZeroDivisionError)
    assert answers[1].job == Job("b", 0)


def test_an_interruption_is_no_answer():
    def interrupted(x):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        next(InProcess().map(interrupted, [Job("a", 1)]))
