"""Which curves a suite's page draws."""

from __future__ import annotations

from simbench.report.suite_plots import curve_plots


def at(value: float, system: str, **means: float) -> dict:
    metrics = {name.replace("_dot_", "."): {"mean": mean, "low": mean, "high": mean}
               for name, mean in means.items()}
    return {"case": "boxes", "point": {"texture": value}, "system": system, "metrics": metrics}


def test_a_metric_with_values_at_one_point_alone_has_no_curve():
    summary = [at(1.0, "sdpl", camera_dot_E_t=0.1, camera_dot_coverage=1.0),
               at(0.5, "sdpl", camera_dot_E_t=0.2),
               at(1.0, "vdo", camera_dot_E_t=0.1)]
    plots = curve_plots(summary, [], "texture", ("camera.E_t", "camera.coverage"),
                        ("sdpl", "vdo"), {}, None)
    assert [plot.title for plot in plots] == ["camera: translation error of a motion"]
    assert "vdo" not in plots[0].svg        # one point is no curve either
