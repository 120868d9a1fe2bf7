"""Drawings of a report: pure functions from the key `drawings` of report.json to SVG, without scripts.

gallery        all drawings of a document, with the reason where there is none
trajectories   vehicles from above, with the moments on their way
distances      distance over time, with the rule's thresholds
ages           pose ages: distribution, and over time per vehicle
ways           an event's way as a Gantt chart, with its critical path
cores          cores over time by component
coverage       recordings with windows and gaps
figures        what a drawing is; the frame of its picture, titles, axes
scales         from values to places, ticks
elements       SVG elements
reading        series of a document: what is no number is left out
"""
