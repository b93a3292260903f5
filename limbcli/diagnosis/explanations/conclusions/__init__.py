"""Conclusions: verdict, effect sizes, undetectable effects, proposed next measurement, summary sentences."""
