"""The analysis of Alluhydan et al., Mathematics 2024, 12(19), 3046: equations, figures, table."""
