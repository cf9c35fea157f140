"""One run on a test bench whose law is known, in the layouts that testers and loggers export."""

import numpy as np

PSI = 6.894757293168361
TRUTH = {(1, 0): -60.0, (0, 1): 0.9, (2, 0): 40.0, (1, 1): -0.55, (0, 2): 0.002}
"""f = Σ c ε^i p^j [N] of one actuator, positive pushing, p in kPa."""
GAUGE = 80.0
"""[mm]."""
TIME = np.arange(0.0, 40_000.0, 100.0)
"""The tester's stamps [ms]."""
STAMPS = np.arange(13.0, 41_000.0, 100.0)
"""The logger's, on the same clock."""


def strain_at(time):
    return 0.25 + 0.2 * np.sin(time / 2700.0) + 0.05 * np.sin(time / 700.0)


def pressure_at(time):
    return 30 * (1 - np.cos(time / 1700.0))


def force_at(time):
    strain, p = strain_at(time), pressure_at(time)
    return sum(c * strain**i * p**j for (i, j), c in TRUTH.items())


STRAIN, PULL = strain_at(TIME), -force_at(TIME)
EXTENSION = GAUGE * STRAIN


def lines(*columns, separator=",", quote="", decimal=".", formats=None):
    """Rows of columns, each of its own format."""
    formats = formats or ["{:.6f}"] * len(columns)
    cells = [
        [quote + form.format(x).replace(".", decimal) + quote for x in own]
        for own, form in zip(columns, formats, strict=True)
    ]
    return [separator.join(row) for row in zip(*cells, strict=True)]


def text(*parts, end="\n"):
    return end.join([line for part in parts for line in ([part] if isinstance(part, str) else part)]) + end


REFERENCE = text(
    ["Time,Displacement,Tensile strain (Displacement),Force", "(ms),(mm),(%),(N)"],
    lines(TIME, EXTENSION, 100 * STRAIN, PULL, quote='"'),
)
_DOUBLED = np.sort(np.concatenate((np.arange(400), [20, 60, 100, 140, 180, 220, 260, 300, 340, 380])))

TESTERS = {
    "reference": (REFERENCE, []),
    "semicolons and decimal commas": (
        text(
            ["Time;Displacement;Tensile strain (Displacement);Force", "(s);(mm);(%);(kN)"],
            lines(TIME / 1000, EXTENSION, 100 * STRAIN, PULL / 1000, separator=";", decimal=","),
        ),
        [],
    ),
    "quoted decimal commas between commas": (
        text(
            ['"Zeit","Dehnung","Kraft"', '"(s)","(%)","(N)"'],
            lines(TIME / 1000, 100 * STRAIN, PULL, quote='"', decimal=","),
        ),
        [],
    ),
    "preamble, Load, sec": (
        text(
            ["Dimension : Length,80,mm", "Dimension : Width,20,mm", ""],
            "Time,Extension,Load,Tensile strain,Tensile stress,Tensile extension",
            "(sec),(mm),(N),(mm/mm),(MPa),(mm)",
            lines(TIME / 1000, EXTENSION, PULL, STRAIN, PULL / 10, EXTENSION),
        ),
        [],
    ),
    "no strain": (
        text(
            ['"Results Table 1"', '"Time","Extension","Load"', '"(s)","(mm)","(kN)"'],
            lines(TIME / 1000, EXTENSION, PULL / 1000, quote='"', formats=["{:.3f}", "{:.4f}", "{:.7f}"]),
        ),
        ["--gauge-length", "80 mm"],
    ),
    "extensions in inches, forces in pounds": (
        text(
            "Time (s),Crosshead [in],Load [lbf]",
            lines(TIME / 1000, EXTENSION / 25.4, PULL / 4.4482216152605),
        ),
        ["--gauge-length", "3.1496063 in"],
    ),
    "units in names, a column to be named": (
        text(
            "Time (s),Displacement (mm),Force (kN),AVE 2 (%),Cycle count",
            lines(
                *(TIME / 1000, EXTENSION, PULL / 1000, 100 * STRAIN, 0 * TIME),
                formats=["{:g}", "{:.4f}", "{:.7f}", "{:.4f}", "{:.0f}"],
            ),
        ),
        ["--columns", "strain=AVE 2"],
    ),
    "a specimen's number and a label column": (
        text(
            ["1,Time,Displacement,Tensile strain (Displacement),Force", ",(ms),(mm),(%),(N)"],
            ['"",' + row for row in lines(TIME, EXTENSION, 100 * STRAIN, PULL, quote='"')],
        ),
        [],
    ),
    "labels with commas in quotes": (
        text(
            "Step,Time (ms),Strain (%),Force (N)",
            ['"hold, then go",' + row for row in lines(TIME, 100 * STRAIN, PULL)],
        ),
        [],
    ),
    "two strains, one to be named": (
        text(
            ["Time,Extension,Force,Strain 1,Strain 2,Displacement (Strain 1)", "(s),(mm),(N),(%),(%),(mm)"],
            lines(TIME / 1000, EXTENSION, PULL, 50 * STRAIN, 100 * STRAIN, EXTENSION),
        ),
        ["--columns", "strain=Strain 2"],
    ),
    "stamps that repeat": (
        text(
            ["Time,Strain,Force", "(s),(%),(N)"],
            np.array(lines(TIME / 1000, 100 * STRAIN, PULL))[_DOUBLED].tolist(),
        ),
        [],
    ),
    "kgf": (text(["Time,Strain,Force", "(s),(%),(kgf)"], lines(TIME / 1000, 100 * STRAIN, PULL / 9.80665)), []),
    "mN with thousands": (
        text(
            ["Time;Strain;Force", "[s];[%];[mN]"],
            [f"{t:.3f};{e:.4f};{1000 * f:,.1f}" for t, e, f in zip(TIME / 1000, 100 * STRAIN, PULL, strict=True)],
        ),
        [],
    ),
    "separators behind the last cell": (
        text(
            ["Time,Displacement,Tensile strain (Displacement),Force,", "(ms),(mm),(%),(N),"],
            [row + "," for row in lines(TIME, EXTENSION, 100 * STRAIN, PULL, quote='"')],
        ),
        [],
    ),
    "a footer": (
        text(
            ["Time (ms),Strain (%),Force (N)"],
            lines(TIME, 100 * STRAIN, PULL),
            ["", "Maximum,45.0,12.5", "End of data"],
        ),
        [],
    ),
    "two header lines": (
        text(["Time,Strain,Force", "Time,Strain,Force", "(ms),(%),(N)"], lines(TIME, 100 * STRAIN, PULL)),
        [],
    ),
    "words in three lines": (
        text(
            ["Time,Strain,Force", "(ms),(%),(N)"],
            (rows := lines(TIME, 100 * STRAIN, PULL))[:50],
            ["Segment 2"], rows[50:80], ["12000,NaN,1.0"], rows[80:],
        ),
        [],
    ),
    "words between every few lines": (
        text(
            ["Time,Strain,Force", "(ms),(%),(N)"],
            [line for row in rows for line in ([row, "valve, open"] if row[-2] in "05" else [row])],
        ),
        [],
    ),
    "empty cells where another was sampled": (
        text(
            ["Time,Strain,Force,Temperature", "(ms),(%),(N),(K)"],
            [line for row in rows for line in (row + ",", f"{row.split(',')[0]}1,,,293.5")],
        ),
        [],
    ),
    "compressive extensions and loads": (
        text(
            ['"Specimen label","1"', "", '"Time","Compressive extension","Compressive load"', '"(s)","(mm)","(N)"'],
            lines(TIME / 1000, -EXTENSION, -PULL, quote='"'),
        ),
        ["--gauge-length", "80 mm"],
    ),
    "both senses": (
        text(
            ['"Results Table 1"', '"","Maximum Load","Extension"', '"","(N)","(mm)"', '"1","55.1","12.2"', ""],
            ['"Time","Extension","Load","Compressive extension","Compressive load"', '"(s)","(mm)","(N)","(mm)","(N)"'],
            lines(TIME / 1000, EXTENSION, PULL, -EXTENSION, -PULL, quote='"'),
        ),
        ["--gauge-length", "80 mm"],
    ),
    "a German tester's": (
        text(
            ['"Prüfzeit" ; "Stauchung" ; "Druckkraft"', '"s" ; "mm" ; "N"'],
            lines(TIME / 1000, -EXTENSION, -PULL, separator=";", decimal=","),
        ),
        ["--gauge-length", "80 mm"],
    ),
    "forces that push, and nobody says so": (
        text("Time[ms];Extension[mm];Force[N]", lines(TIME, EXTENSION, -PULL, separator=";")),
        ["--gauge-length", "80 mm"],
    ),
    "times of day": (
        text("Time,Strain (%),Force (N)", [f"00:00:{row}" for row in lines(TIME / 1000, 100 * STRAIN, PULL)]),
        [],
    ),
    "units behind numbers": (
        text(
            "Time;Strain;Force",
            lines(TIME / 1000, 100 * STRAIN, PULL, separator=";", formats=["{:.2f} s", "{:.4f} %", "{:.5f}N"]),
        ),
        [],
    ),
    "a measurement of a laboratory's program": (
        text(
            ["LabVIEW Measurement\t", "Separator\tTab", "Date\t2024/05/01", "Time\t12:00:00.1234567"],
            ["***End_of_Header***\t", "\t", "Channels\t2\t\t\t", "Samples\t400\t400\t\t", "X0\t0.0\t0.0\t\t"],
            ["***End_of_Header***\t\t\t", "X_Value\tForce\tDisplacement\tComment"],
            [row + "\t" for row in lines(TIME / 1000, PULL, EXTENSION, separator="\t")],
        ),
        ["--gauge-length", "80 mm", "--columns", "time=X_Value:s,force=Force:N,extension=Displacement:mm"],
    ),
    "names and words of a laboratory's program, extensions in µm": (
        text("# time [s] laser displacement [\u03bcm] force [N]".replace("laser ", ""),
             lines(TIME / 1000, 1000 * EXTENSION, PULL, separator=" ")),
        ["--gauge-length", "80 mm"],
    ),
    "forces in grams": (text("millis,load_g,stroke_um", lines(TIME, PULL / 9.80665e-3, 1000 * EXTENSION)),
        ["--gauge-length", "80 mm"]),
    "blanks, and forces that push": (
        text("Time[ms]  Strain[%]  Force[N]", lines(TIME, 100 * STRAIN, -PULL, separator="   ")),
        ["--positive", "push"],
    ),
}  # fmt: skip


def log(header, factor=1 / PSI, clock=1.0, *, separator=",", end="\n", closing="Logging end", shift=0.0, digits=6):
    """A logger's file; its header may be glued to the first sample."""
    formats = ["{:.12g}" if shift == 0 else "{:.3f}", f"{{:.{digits}f}}"]
    rows = lines(STAMPS * clock + shift, pressure_at(STAMPS) * factor, separator=separator, formats=formats)
    head = [header] if header else []
    if header.endswith("<glued>"):
        head, rows[0] = [], header.removesuffix("<glued>") + rows[0]
    return text(head, rows, [closing] if closing else [], end=end)


REFERENCE_LOG = log("Time,Pressure")
_EXACT = log("", 1.0, closing="").splitlines()
_GERMAN = {"separator": ";", "decimal": ",", "formats": ["{:06.3f}", "{:.7f}"]}
_THREE = [f"{100 * k},{p / PSI:.4f}" for k in range(410) for p in [pressure_at(100.0 * k)] * 3]
_JITTERED = [f"{stamp - (30 if k % 40 == 7 else 0):.0f},{pressure_at(stamp):.4f}" for k, stamp in enumerate(STAMPS)]
_JITTERED[8], _JITTERED[9] = _JITTERED[9], _JITTERED[8]
_GLUED_ROWS = log("Time,Pressure").splitlines()
_GLUED_ROWS[200] += _GLUED_ROWS.pop(201)

LOGS = {
    "reference": (REFERENCE_LOG, []),
    "kPa in brackets": (log("Time (ms),Pressure (kPa)", 1.0), []),
    "kPa as a word, no closing line": (log("timestamp_ms,pressure_kPa", 1.0, closing=""), []),
    "glued words": (log("TimeMs,PressureMPa", 0.001, digits=9), []),
    "hPa": (log("Time,Pressure (hPa)", 10.0), []),
    "quoted names": (log('"Time (ms)","Pressure (mbar)"', 10.0), []),
    "seconds": (log("Time (s),Pressure (psi)", clock=1e-3), []),
    "minutes": (log("Time (min),Pressure (Pa)", 1000.0, 1 / 60_000), []),
    "columns the other way round": (
        text("Pressure (kPa),Time (ms)", lines(pressure_at(STAMPS), STAMPS), "end"),
        [],
    ),
    "three samples a stamp, no closing line": (text("Time, Pressure", _THREE, end="\r\n"), []),
    "a clock that steps back a little": (text("Time (ms),Pressure (kPa)", _JITTERED), []),
    "two samples in one line": (text(_GLUED_ROWS), []),
    "the first sample in the header's line": (log("Time,Pressure<glued>", end="\r\n"), []),
    "a carriage return and a half": (log("Time,Pressure", end="\r\r\n"), []),
    "seconds since 1970, no header": (
        log("", 1.0, 1e-3, separator="\t", shift=1690000000.0, closing=""),
        ["--unit", "kPa", "--offset", "-1690000000000"],
    ),
    "the same, said by columns": (
        log("", 1.0, 1e-3, separator="\t", shift=1690000000.0, closing=""),
        ["--pressure-columns", "time=1:s,pressure=2:kPa", "--offset", "-1690000000000"],
    ),
    "set points and words": (
        text(
            "t (ms);Setpoint (bar);Pressure (bar);event",
            [
                f"{t:.0f};0,5;{p / 100:.6f};".replace(".", ",") + ("valve" if t % 9 else "")
                for t, p in zip(STAMPS, pressure_at(STAMPS), strict=True)
            ],
        ),
        [],
    ),
    "gauge units in brackets of their own": (log("Time (ms),Pressure (bar(g))", 0.01, digits=8), []),
    "no value now and then": (
        text("Time (ms),Pressure (kPa)", [x if k % 9 else x.split(",")[0] + ",OVLD" for k, x in enumerate(_EXACT)]),
        [],
    ),
    "dates": (
        text(
            "Timestamp;Pressure [barg]",
            [f"01.05.2024 00:00:{row}" for row in lines(STAMPS / 1000, pressure_at(STAMPS) / 100, **_GERMAN)],
        ),
        ["--offset", "-1714521600000"],
    ),
    "a name before each number": (
        text([f"time_ms: {row}" for row in lines(STAMPS, pressure_at(STAMPS), separator=", pressure_kPa: ")]),
        [],
    ),
    "names, numbers and units": (
        text([f"t={row} psi" for row in lines(STAMPS, pressure_at(STAMPS) / PSI, separator=" ms; p=")]),
        [],
    ),
    "names, numbers and units between blanks": (
        text([f"T: {row} psi" for row in lines(STAMPS, pressure_at(STAMPS) / PSI, separator=" ms P: ")]),
        [],
    ),
    "minutes and seconds": (
        text("Time,Pressure (kPa)", [f"00:{row}" for row in lines(STAMPS / 1000, pressure_at(STAMPS))]),
        [],
    ),
    "a monitor's stamps": (
        text([f"00:00:{row}" for row in lines(STAMPS / 1000, pressure_at(STAMPS), separator=" -> ")]),
        ["--unit", "kPa"],
    ),
    "times in words beside": (
        text(
            "Date,Elapsed (s),Pressure (kPa)",
            [
                f"2024-05-01 10:00:{t / 1000 % 60:06.3f},{t / 1000:.3f},{p:.4f}"
                for t, p in zip(STAMPS, pressure_at(STAMPS), strict=True)
            ],
        ),
        [],
    ),
}  # fmt: skip

ONE_FILE = (
    text(lines(TIME, 3 + STRAIN, 0 * TIME, -PULL / 50, EXTENSION, pressure_at(TIME) / 100, PULL, separator="\t")),
    ["--columns", "time=1:ms,extension=5:mm,pressure=6:bar,force=7:N", "--gauge-length", "80 mm"],
)
"""Without header: ms, three others, mm, bar, N."""

MUSCLE = {(0, 1): -0.643855, (1, 1): -2.383904, (2, 1): -1.311147}
"""An ideal McKibben muscle's force."""


def muscle(strain, pressure):
    return sum(c * strain**i * pressure**j for (i, j), c in MUSCLE.items())


_STRAINS, _PRESSURES = np.linspace(0, -0.25, 6), np.arange(0.0, 700.0, 100.0)
LONG = text(
    "strain,pressure_kPa,force_N",
    [f"{e:.3f},{p:.0f},{muscle(e, p):.4f}" for e in _STRAINS for p in _PRESSURES],
)
WIDE = text(
    "contraction [%];" + ";".join(f"{p / 100:.0f} bar" for p in _PRESSURES),
    [";".join([f"{-100 * e:.0f}", *(f"{-muscle(e, p):.3f}".replace(".", ",") for p in _PRESSURES)]) for e in _STRAINS],
)
FORCES_AT = text(
    "Kontraktion %;" + ";".join(f"Kraft bei {p / 100:.0f} bar" for p in _PRESSURES),
    [
        ";".join([f"{-100 * e:.0f}", *(f"{-muscle(e, p):.3f} N".replace(".", ",") for p in _PRESSURES)])
        for e in _STRAINS
    ],
)
MILLIMETRES = text(
    "shortening [mm];" + WIDE.splitlines()[0].partition(";")[2],
    [f"{2 * int(row.split(';')[0])};{row.partition(';')[2]}" for row in WIDE.splitlines()[1:]],
)
ABSOLUTE = text(
    "strain,pressure (kPa abs),force_N",
    [f"{e:.3f},{p + 101.325:.3f},{muscle(e, p):.4f}" for e in _STRAINS for p in _PRESSURES],
)
TURNED = text(
    ["Pull (force) [kN]", "pressure [MPa] \\ contraction [%]," + ",".join(f"{-100 * e:.0f}" for e in _STRAINS)],
    [",".join([f"{p / 1000:.1f}", *(f"{-muscle(e, p) / 1000:.7f}" for e in _STRAINS)]) for p in _PRESSURES],
)


def data_sheet_muscle(contraction, pressure):
    """A fluidic muscle's pull [N] by pressure [kPa], not below 0, with exponentials of contraction as Sárosi has them.

    It falls steeply from the start, as data sheets show and no polynomial follows well; the numbers are made up.
    """
    percent = 100 * contraction
    steep = (pressure + 260) * np.exp(-0.35 * percent) - 260 * np.exp(-0.3 * percent)
    return np.maximum(steep - 0.09 * percent * pressure + 2.4 * pressure, 0.0)
