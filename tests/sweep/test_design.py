"""Designs: how samples are drawn, checked and planned, and everything that is refused before anything runs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc
from sweep_files import SCENE, write

from mvla_sim.distributions import AnyChoice, Spread, value_at
from mvla_sim.errors import ConfigError
from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.sweep.design import DesignSettings
from mvla_sim.sweep.design_plan import plan_design
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.sampling import draw_samples
from mvla_sim.sweep.scores import metric_names

EXAMPLE = Path(__file__).with_name("design.toml")


def example(folder, *overrides):
    """The example beside this file, with its scene."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "box.toml").write_text(SCENE)
    (folder / "design.toml").write_text(EXAMPLE.read_text())
    return load_experiment(folder / "design.toml", overrides)


def design(folder, text, axes="seed = [0, 1]\n", **others):
    return load_experiment(write(folder, axes, text, **others))


def values(distribution, count=1000):
    return [value_at(distribution, share) for share in (np.arange(count) + 0.5) / count]


def test_distributions_have_their_values_at_their_shares():
    assert np.quantile(values(Spread(min=2, max=4)), [0, 0.25, 1]) == pytest.approx([2, 2.5, 4], abs=0.01)
    logarithmic = values(Spread(min=1e-9, max=1e-5, scale="log"))
    assert np.quantile(np.log10(logarithmic), [0, 0.5, 1]) == pytest.approx([-9, -7, -5], abs=0.02)
    steps = Counter(values(Spread(min=3, max=6, step=1)))
    assert steps == {3: 250, 4: 250, 5: 250, 6: 250}
    assert {type(value) for value in steps} == {int}
    assert set(values(Spread(min=0.1, max=0.5, step=0.1))) == {0.1, 0.2, 0.3, 0.4, 0.5}
    assert set(values(Spread(min=0, max=1, step=0.4))) == {0.0, 0.4, 0.8}  # whole steps, not the upper end
    assert Counter(values(AnyChoice(choices=("a", 1, True, None)))) == {"a": 250, 1: 500, None: 250}  # 1 equals true
    assert Counter(values(AnyChoice(choices=("a", "b"), weights=(3, 1)))) == {"a": 750, "b": 250}
    for share in (0.0, 1.0):
        assert value_at(Spread(min=3, max=6, step=1), share) in (3, 6)
        assert value_at(AnyChoice(choices=("a", "b")), share) in ("a", "b")


def test_a_choice_may_be_none(tmp_path):
    text = '[design]\nsamples = 8\n[design.settings]\nsnr_db = { choices = ["none", 5.0] }\n'
    plan = plan_design(design(tmp_path, text))
    assert Counter(case.imaging.noise.snr_db for case in plan.cases) == {None: 8, 5.0: 8}


@pytest.mark.parametrize("draw", ["sobol", "random"])
def test_the_first_of_more_samples_are_those_of_fewer(draw):
    few, many, other = (
        [dict(sample.values) for sample in draw_samples(of(samples, draw, seed))]
        for samples, seed in ((5, 0), (64, 0), (64, 1))
    )
    assert many[:5] == few
    assert many != other
    assert len({sample["kappa"] for sample in many}) == 64
    labels = [sample.label for sample in draw_samples(of(5, draw))]
    assert labels == ["s0000", "s0001", "s0002", "s0003", "s0004"]


def of(samples, draw, seed=0):
    settings = {"kappa": {"min": 0.0, "max": 1.0}, "eta": {"min": 0.0, "max": 1.0}, "snr_db": 5.0}
    return DesignSettings(samples=samples, draw=draw, seed=seed, settings=settings)


def test_sobol_points_fill_the_square_more_evenly_than_random_ones():
    found = {}
    for draw in ("sobol", "random"):
        rows = [sample.values for sample in draw_samples(of(64, draw))]
        assert {row["snr_db"] for row in rows} == {5.0}
        found[draw] = qmc.discrepancy(np.array([[row["kappa"], row["eta"]] for row in rows]))
    assert found["sobol"] < 0.3 * found["random"]


def test_each_sample_is_the_whole_product_with_its_settings(tmp_path):
    plan = plan_design(example(tmp_path))
    assert (len(plan.samples), plan.counts, len(plan.cases)) == (8, (8, 4, 1), 16)
    for sample in plan.samples:
        first, second = (case for case in plan.cases if case.values["sample"] == sample.label)
        assert (first.imaging.noise.seed, second.imaging.noise.seed) == (0, 1)
        for case in (first, second):
            assert case.imaging.mvla.kappa == sample.values["kappa"]
            assert case.imaging.noise.kind == sample.values["noise.kind"]
            assert case.imaging.noise.snr_db == 10
            assert case.imaging.views.interval_deg == 60  # the round's own
            assert case.values["round"] == 1
            assert sample.values.items() <= case.values.items()
    second = plan.plan_of(1, plan.samples[2:4], first=16)
    assert [case.number for case in second.cases] == list(range(16, 24))
    assert Counter(case.values["sample"] for case in second.cases) == {"s0002": 4, "s0003": 4}
    known = {case.key for case in plan.cases}
    assert sum(case.key in known for case in second.cases) == 4  # half of them ran in the first round
    third = plan.plan_of(2, plan.samples[:1])
    assert Counter(case.values["part"] for case in third.cases) == {"1": 4, "offsets": 6}


def test_a_sample_has_the_key_of_the_same_settings_in_an_experiment(tmp_path):
    """So a figure of a design can be had again without it."""
    plan = plan_design(example(tmp_path))
    case = plan.cases[5]
    own = [
        f'{key}="{value}"' if isinstance(value, str) else f"{key}={value}"
        for key, value in case.values.items()
        if key not in ("scene", "round", "sample", "seed")
    ]
    file = write(tmp_path, "seed = [0, 1]\n")
    alone = expand(load_experiment(file, own))
    assert case.key in {other.key for other in alone.cases}


def test_listed_samples_run_as_they_are(tmp_path):
    text = """
[design]
draw = "list"
[[design.list]]
sample = "paper"
kappa = 0.5
snr_db = "none"
[[design.list]]
sample = "other"
kappa = 1.0
snr_db = 3.0
"""
    plan = plan_design(design(tmp_path, text))
    assert [sample.label for sample in plan.samples] == ["paper", "other"]
    found = [(case.imaging.mvla.kappa, case.imaging.noise.snr_db) for case in plan.cases]
    assert found == [(0.5, None)] * 2 + [(1.0, 3.0)] * 2


def test_samples_that_cannot_be_are_refused_before_anything_runs(tmp_path):
    settings = design(tmp_path, VIEWS.format(invalid="refuse"))
    with pytest.raises(ConfigError, match=r"sample s00\d\d \(interval_deg = 70.0, kappa = .*does not divide") as raised:
        plan_design(settings)
    assert "the first of" in str(raised.value)
    assert "\n" not in str(raised.value)


VIEWS = """
[design]
samples = 16
invalid = "{invalid}"
[design.settings]
interval_deg = {{ choices = [60.0, 70.0], weights = [3, 1] }}
kappa = {{ min = 0.1, max = 1.0 }}
[[design.rounds]]
keep = 0.5
[[design.rounds]]
axes = {{ seed = [0, 1, 2] }}
"""


def test_samples_that_cannot_be_may_be_skipped(tmp_path):
    plan = plan_design(design(tmp_path, VIEWS.format(invalid="skip")))
    assert (len(plan.every), len(plan.samples), len(plan.invalid)) == (16, 12, 4)
    assert plan.counts == (12, 6)
    assert all("does not divide" in why for why in plan.invalid.values())
    assert {case.values["interval_deg"] for case in plan.cases} == {60.0}
    assert [case.number for case in plan.cases] == list(range(24))


def test_later_rounds_are_checked_too(tmp_path):
    text = VIEWS.format(invalid="refuse").replace("70.0", "20.0").replace("seed = [0, 1, 2]", "eta = [0.1, -1.0]")
    with pytest.raises(
        ConfigError, match=r"sample s0000 \(.*\): mvla.eta = -1.0: .* \[the first of 16 of 16 samples\]"
    ):
        plan_design(design(tmp_path, text))


FOUR = "[design]\nsamples = 4\n[design.settings]\nkappa = { min = 0.1, max = 1.0 }\n"


def drawn(text, head="samples = 4\n"):
    """A design over such settings."""
    return f"[design]\n{head}[design.settings]\n{text}\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (drawn("kapa = { min = 1, max = 2 }"), "'kapa' names no setting"),
        (drawn('"noise.snr" = { min = 1, max = 2 }'), r"sample s0000 .*noise\.snr: unknown key"),
        (drawn('"noise.snr" = { min = 1, max = 2 }', 'samples = 4\ninvalid = "skip"\n'), r"noise\.snr: unknown key"),
        (drawn('kappa = { min = 1, max = 2 }\n"mvla.kappa" = { min = 1, max = 2 }'), "name the same setting"),
        (drawn("kappa = { normal = [0, 1] }"), "a table of normal is no distribution; write one value"),
        (drawn("kappa = { uniform = [0, 1] }"), "a table of uniform is no distribution"),
        (drawn("kappa = {}"), "a table of nothing is no distribution"),
        (drawn("kappa = { choices = [] }"), r"kappa.*choices"),
        (drawn("kappa = { choices = [1, 2], weights = [1] }"), "weights has 1 entries for 2 choices"),
        (drawn("kappa = { min = 2.0, max = 1.0 }"), "min = 2 must be below max = 1"),
        (drawn("kappa = { min = 1.0, max = 1.0 }"), "min = 1 must be below max = 1"),
        (drawn("kappa = { min = 1.0 }"), "a table of min is no distribution"),
        (drawn('kappa = { min = 0.0, max = 1.0, scale = "log" }'), "min = 0 with scale = 'log': must be above 0"),
        (drawn('kappa = { min = -1, max = 1.0, scale = "log" }'), "min = -1 with scale = 'log'"),
        (drawn("kappa = { min = 0, max = 1, step = 2 }"), "step = 2 does not fit"),
        (drawn("kappa = { min = 0, max = 1, step = 0 }"), "step = 0"),
        (drawn("kappa = 0.5"), "no distribution"),
        (drawn("kappa = { min = -2.0, max = -1.0 }"), r"sample s0000 \(kappa = -.*mvla.kappa = -"),
        (drawn("kappa = { min = 0.1, max = 1.0 }", "samples = 0\n"), r"design\.samples = 0"),
        (drawn("kappa = { min = 0.1, max = 1.0 }", ""), r"design: samples: missing key"),
        (drawn("seed = { min = 0, max = 9, step = 1 }"), "'seed' is a setting of the design, and an axis"),
        (drawn('"imaging.noise.seed" = { min = 0, max = 9, step = 1 }'), "is a setting of the design, and an axis"),
        (
            drawn("kappa = { min = 0.1, max = 1.0 }", 'samples = 4\nscore = "cd_bd"\n'),
            "no metric or score .did",
        ),
        (drawn("kappa = { min = 0.1, max = 1.0 }", 'samples = 4\nscore = "protocol"\n'), "no metric or score"),
        (drawn("kappa = { min = 0.1, max = 1.0 }", 'samples = 4\nscore = "none.py:f"\n'), "none.py cannot be read"),
        (drawn("kappa = { min = 0.1, max = 1.0 }", 'samples = 4\ndraw = "halton"\n'), r"design\.draw = 'halton'"),
        (
            f"{FOUR}[[design.rounds]]\nkeep = 0.2\n[[design.rounds]]\n",
            "0.2 of 4 samples keeps none",
        ),
        (f"{FOUR}[[design.rounds]]\nkeep = 0.0\n[[design.rounds]]\n", r"rounds\[0\]\.keep = 0"),
        (f"{FOUR}[[design.rounds]]\nkeep = 1.1\n[[design.rounds]]\n", r"rounds\[0\]\.keep = 1.1"),
        (f"{FOUR}[[design.rounds]]\nkeep_count = 0\n[[design.rounds]]\n", r"keep_count = 0"),
        (
            f"{FOUR}[[design.rounds]]\nkeep = 0.5\nkeep_count = 1\n[[design.rounds]]\n",
            "keep and keep_count both",
        ),
        (f"{FOUR}[[design.rounds]]\n[[design.rounds]]\n", r"rounds\[0\] needs keep"),
        (f"{FOUR}[[design.rounds]]\nkeep = 0.5\n", r"rounds\[0\] is the last"),
        (
            f"{FOUR}[[design.rounds]]\noverrides = {{ kappa = 1 }}\n",
            "'kappa' is a setting of the des",
        ),
        (f"{FOUR}[[design.rounds]]\noverrides = {{ kapa = 1 }}\n", "'kapa' names no setting"),
        (
            f"{FOUR}[[design.rounds]]\noverrides = {{ seed = 1 }}\n",
            "'seed' is an axis of that round",
        ),
        (f"{FOUR}[[design.rounds]]\naxes = {{ kappa = [1] }}\n", "of the design, and an axis"),
        (f"{FOUR}[[design.rounds]]\naxes = {{ kapa = [1] }}\n", "'kapa' names no setting"),
        (
            f"{FOUR}[[design.rounds]]\n[[design.rounds.parts]]\naxes = {{ 'mvla.kappa' = [1] }}\n",
            "of the design, and an axis",
        ),
        ('[design]\ndraw = "list"\n', "at least one sample"),
        ('[design]\ndraw = "list"\nlist = [{ kappa = 1 }, { eta = 1 }]\n', "differ in having 'eta'"),
        ('[design]\ndraw = "list"\nlist = [{ kapa = 1 }]\n', "'kapa' names no setting"),
        (
            '[design]\ndraw = "list"\nlist = [{ kappa = 1, sample = "a" }, { kappa = 2, sample = "a" }]\n',
            "are named 'a'",
        ),
        ('[design]\ndraw = "list"\nsamples = 3\nlist = [{ kappa = 1 }]\n', "leave samples and settings out"),
        ("[design]\nsamples = 3\nlist = [{ kappa = 1 }]\n", "list is of draw = 'list'"),
        (drawn("kappa = { min = 0.1, max = 1.0 }") + '[[variants]]\nlabel = "a"\n', "variants and design"),
        (drawn("kappa = { min = 0.1, max = 1.0 }") + "[[show]]\nseed = 1\n", "show and design"),
    ],
)
def test_a_design_that_cannot_be_is_refused(tmp_path, text, said):
    with pytest.raises(ConfigError, match=said) as raised:
        plan_design(design(tmp_path, text))
    assert "\n" not in str(raised.value)


def test_the_limit_is_of_a_round(tmp_path):
    settings = example(tmp_path)
    assert len(plan_design(settings, limit=16).cases) == 16
    with pytest.raises(ConfigError, match=r"round 1: at least 16 cases; above 15 shorten the axes, or lift the limit"):
        plan_design(settings, limit=15)
    more = example(tmp_path, "design.rounds.2.parts.0.axes.seed=[0,1,2,3,4,5,6,7,8]")
    with pytest.raises(ConfigError, match="round 3: at least 19 cases"):
        plan_design(more, limit=16)


def test_an_experiment_with_a_design_is_not_expanded_as_one_without(tmp_path):
    with pytest.raises(ConfigError, match="has a design"):
        expand(example(tmp_path))
    with pytest.raises(ConfigError, match="has no design"):
        plan_design(load_experiment(write(tmp_path)))


def test_metrics_that_may_be_scores_are_those_of_a_table():
    names = metric_names(EvaluationSettings())
    assert {"cd_db", "seconds", "views", "top_percent", "optimal_cd_db", "f1_10cm"} <= set(names)
    assert "protocol" not in names
