"""Where lamp and camera should stand for photographs of a piece that is flat, or nearly so.

`piece.py` is what is photographed, `set_up.py` what a person can place where, `view.py` what a
known camera sees from there, `choice.py` which places tell most, `plan.py` the result,
`plan_file.py` the same as files, `plan_check.py` whether photographs were taken as planned.
"""
