"""The example and Tables 1-6 as the paper prints them, as data.

Printed numbers are kept as strings, so that their digits stay countable; None where the paper leaves a cell
empty. Lengths in cm, forces in kN, angles in degrees, as printed, misprints included.

Bo Hu, Yi Lu, Jing Jing Yu, Shan Zhuang: Analyses of Inverse Kinematics, Statics and Workspace of a Novel
3RPS-3SPR Serial-Parallel Manipulator.
"""

from __future__ import annotations

Row = tuple[str | None, ...]

# The example of Section 5, with E = 120/√3, C = 60/√3, d = 80 cm.
POSITION = (68.89, 49.63, 225.3)
"""Position of o in {B} [cm]."""
XYX_DEGREES = (-11.08, 32.97, -12.88)
"""The angles α, β, λ [degrees]."""
POSE_AS_PRINTED = ("68.89", "49.63", "225.3", "-11.08", "32.97", "-12.88")
"""Position [cm] and angles [degrees] with their digits."""
VELOCITY = (1.0, 2.0, 3.0, 1.0, 2.0, 3.0)
"""The twist: v [cm/s], ω [degrees/s]."""
FORCE = (-20.0, -30.0, -30.0)
"""The force F on the platform [kN]."""
TORQUE = (-30.0, -30.0, 100.0)
"""The torque T on the platform [kN cm]."""

TABLE_1: tuple[Row, Row, Row] = (
    ("50.667", "45.141", "39.998", "21.167", "-90.26+167.89i", "-51.398", "-40.555", "-90.26-167.89i"),
    ("-29.253", "-26.06", "-23.093", "-12.22", "52.111-96.931i", "29.674", "23.415", "52.111+96.931i"),
    ("115.64", "116.73", "117.74", "121.44", "143.37-33.038i", "135.72", "133.59", "143.37+33.038i"),
)
"""Coordinates X, Y, Z of b_1 [cm], a column for each of the solutions 1 to 8."""
TABLE_2: tuple[Row, Row, Row] = (
    ("0", "0", "0", "0", "0", "0", "0", "0"),
    ("32.471", "39.947", "46.19", "64.583", "-138.95-172.52i", "-31.569", "-45.511", "-138.95+172.52i"),
    ("120.44", "118.98", "117.75", "114.15", "154.01+33.785i", "132.98", "135.71", "154.01-33.785i"),
)
"""Coordinates X, Y, Z of b_2 [cm]."""
TABLE_3: tuple[Row, Row, Row] = (
    ("64.528", "65.347", "-37.528", "63.356", "-184.96+13.944i", "-74.269", "29.45", "-184.96-13.944i"),
    ("37.255", "37.728", "-21.667", "36.579", "-106.79+8.0503i", "-42.879", "17.003", "-106.79-8.0503i"),
    ("73.394", "72.88", "137.43", "74.13", "229.93+8.75i", "160.48", "95.40", "229.93+8.75i"),
)
"""Coordinates X, Y, Z of b_3 [cm]."""

TABLE_4: tuple[Row, ...] = (
    ("116.1401", "117.9807", "119.9824", "129.4582", "186.9944", None),
    ("125.9397", "122.5390", "119.9962", "114.2482", "166.8976", "176.9975"),
    ("161.4403", "162.0518", "139.8558", "160.5745", "161.3236", "140.6064"),
    ("125.1317", "124.9137", "125.0120", "127.8178", "167.8407", "159.6376"),
    ("122.7075", "121.0418", "120.0042", "118.8893", "152.6122", "161.9011"),
    ("175.3520", "175.9541", "150.1267", "174.4991", "168.4908", "154.4953"),
)
"""Leg lengths r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [cm], a column for each real solution."""

TABLE_5: tuple[Row, Row] = (
    ("-3.9609", "11.9576", "-31.7202", "9.1684", "-9.9490", None),
    ("-48.9508", "-104.8954", "78.6797", "-22.1896", "-81.8418", None),
)
"""Leg rates [cm/s] and driving forces [kN] at the third solution."""

_B, _C = "bmin~bmax", "cmin~cmax"
TABLE_6: tuple[tuple[str, ...], ...] = (
    ("St1", "bmin bmax", "bmin bmax", "bmax", "cmax", "cmax", "cmax"),
    ("St2", "bmin bmax", "bmax", _B, "cmax", "cmax", "cmax"),
    ("St3", "mmax", _B, _B, "cmax", "cmax", "cmax"),
    ("Sc1", "bmin", _B, "bmax", _C, "cmax", "cmax"),
    ("Sc2", "bmin", "bmin", "bmax", _C, _C, "cmax"),
    ("Sc3", _B, "bmin", "bmax", "cmax", _C, "cmax"),
    ("Sc4", "bmax", "bmin", _B, "cmax", _C, "cmax"),
    ("Sc5", "bmax", "bmin", "bmin", "cmax", _C, _C),
    ("Sc6", "bmax", _B, "bmin", "cmax", "cmax", _C),
    ("Sc7", "bmin bmax", "bmax", "bmin", "cmax", "cmax", _C),
    ("Sc8", "bmin", "bmax", "bmin", _C, "cmax", _C),
    ("Sc9", "bmin", "bmax", _B, _C, "cmax", "cmax"),
    ("Sm1", "bmin", _B, "bmin", _C, "cmax", "cmin"),
    ("Sm2", _B, _B, "bmin", "cmax", "cmax", "cmin"),
    ("Sm3", _B, "bmin", "min", "cmax", _C, "cmin"),
    ("Sm4", _B, "bmin", "bmin", "cmax", "cmin", _C),
    ("Sm5", "bmin bmax", "bmin", "bmin~mmax", "cmax", "cmin", "cmax"),
    ("Sm6", "bmin", "bmin", _B, _C, "cmin", "cmax"),
    ("Sm7", "bmin", "bmin", _B, "cmin", _C, "cmax"),
    ("Sm8", "bmin", "bmin bmax", _B, "cmin", "cmax", "cmax"),
    ("Sm9", "bmin", _B, "bmin", "cmin", "cmax", _C),
    ("Sl1", "bmin", "bmin", "bmin", _C, "cmin", _C),
    ("Sl2", "bmin", "bmin", "bmin", _C, _C, "cmin"),
    ("Sl3", "bmin", "bmin", "bmin", "cmin", _C, _C),
)
"""The 24 surfaces of the workspace: name, and each leg at a limit or between two; a space where "~" is missing."""
