"""Where model and measurement disagree, what could explain it, and what cannot be determined.

Detection, identification and adaptation on plain arrays: nothing here knows a
solver, a case or an effect's physics. `engine.diagnose` works on a `forward_model.ForwardModel`,
which answers three questions: how well does a set of effects fit, in which
directions would one more effect move the prediction, and what would another
measurement see.

Source of the scheme: Teunissen 2018, Journal of Geodesy 92:59 (detection,
identification and adaptation); Westfall & Young 1993, Resampling-Based Multiple
Testing (minimum-p adjustment).
"""
