"""The stability scoreboard: hard cases for every part whose formulas can break, as cells (case, subject, dtype route).

`routes` are the dtypes, `families` and `rigs` the seeded inputs, `exact` the references, `cases/` one file per topic,
`mutants/` the naive formulas that the cases must notice, `board` the outcome. Nothing here is imported by what it tests.
"""
