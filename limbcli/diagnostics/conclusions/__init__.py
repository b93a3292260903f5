"""What is concluded: the verdict, sizes and blind spots of effects, the next measurement, sentences."""
