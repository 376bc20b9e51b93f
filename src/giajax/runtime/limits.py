"""Limits of input files and options; `docs/data_contract.md` lists them.

Each limit is far above what a recording, an arm or a path needs, and below what would take minutes
or fill the memory. Larger inputs are rejected early with one sentence.
"""

RUN_BYTES = 1 << 30  # size of a `.csv` or `.parquet` file
# size of an unpacked `.parquet` file: 8 bytes per number, 64 per text, plus its pages
PARQUET_BYTES = 1 << 28
PARQUET_FOOTER_BYTES = 1 << 22  # size of the metadata of a `.parquet` file
# Numbers in a bag, including two time stamps per message, and in the resulting table.
BAG_NUMBERS = 1 << 24
MESSAGE_BYTES = 1 << 22  # size of a decoded message; as objects it takes about 12 times as much
CHUNK_BYTES = 1 << 27  # size of any other message, and of a compressed chunk of an MCAP file
UNPACKED_TIMES, UNPACKED_BYTES = (
    100,
    1 << 24,
)  # maximum unpacked size of a bag: this multiple of its size, plus this constant
TEXT_BYTES = 1 << 20  # size of a TOML file
RESULT_BYTES = 1 << 26  # size of a `result.json`
JOURNAL_BYTES = 1 << 30  # size of the journal of a fit
DEPTH = 32  # depth of nested tables and lists, and of dotted keys, in TOML and JSON
WHOLE = 2**63  # integers in TOML and JSON are smaller than this, as TOML specifies
NAME_BYTES = 255  # length of the name of a file or folder, as in file systems
COLUMNS = 10_000  # columns of a run
FOREIGN_COLUMNS = 100_000  # columns of a table from another program
CELL_BYTES = 1_000  # length of a cell or of a column name in a CSV file
VALUE = 1e30  # magnitude of a recorded value, in SI units
TIME_S = 1e10  # magnitude of a time stamp: three centuries, enough for stamps relative to 1970
STEP_S = 1e-9  # minimum interval between two samples, s
GAP_S = 3_600.0  # maximum interval between samples of a run that a model integrates over time, s
DURATION_S = 1e5  # duration of a run that a model integrates over time, s
LINKS = 1_000  # links of an arm, and thus numbers of joints and links
ELEMENTS = 1_000  # elements of a hysteresis operator, rows of its mesh, turning points before a run
POSES = 500_000  # poses in a table that drives an arm
STEPS = 1_000  # integration steps per pose of a drive
FILLING_S = 1_000_000  # duration of the filling of an arm, s
ANGLE_DEG = 180.0  # magnitude of a commanded angle of a designed experiment, deg
STARTS = 10_000  # starts of a fit
