"""Where model and measurement disagree, what could explain it, and what cannot be determined.

Detection, identification and adaptation on plain arrays: nothing in this package depends on a
solver, a case or the physics of an effect. `verdict.diagnose` works on a `forward_model.ForwardModel`,
which answers three questions: how well a set of effects fits the data, in which directions one
additional effect would move the prediction, and what a further measurement would show.

Source of the scheme: Teunissen 2018, Journal of Geodesy 92:59 (detection,
identification and adaptation); Westfall & Young 1993, Resampling-Based Multiple
Testing (minimum-p adjustment).
"""
