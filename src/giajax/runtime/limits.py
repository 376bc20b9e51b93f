"""The most that people's files and options may hold; `docs/data_contract.md` lists it.

Each limit is far beyond what a recording, an arm or a path needs, and below what would keep the
program busy for minutes or fill the memory: what is beyond is refused in one sentence, early.
"""

RUN_BYTES = 1 << 30  # size of a `.csv` or `.parquet` file
# Size of a `.parquet` file when it is unpacked: 8 bytes a number, 64 a text, and its pages.
PARQUET_BYTES = 1 << 28
PARQUET_FOOTER_BYTES = 1 << 22  # size of what a `.parquet` file says of itself
# Numbers in a bag, of which the times of a message are two, and in the table that it becomes.
BAG_NUMBERS = 1 << 24
MESSAGE_BYTES = 1 << 22  # size of a message that is read, which takes a dozen times that as objects
CHUNK_BYTES = 1 << 27  # size of any other, and of what an MCAP file packs at once
UNPACKED_TIMES, UNPACKED_BYTES = (
    100,
    1 << 24,
)  # a bag unpacks to so many times its size, and so more
TEXT_BYTES = 1 << 20  # size of a TOML file
RESULT_BYTES = 1 << 26  # size of a `result.json`
JOURNAL_BYTES = 1 << 30  # size of the journal of a fit
DEPTH = 32  # tables and lists within each other, and parts of a dotted key, in TOML and JSON
WHOLE = 2**63  # whole numbers in TOML and JSON are smaller than this, as TOML says
NAME_BYTES = 255  # length of the name of a file or folder: what file systems take
COLUMNS = 10_000  # columns of a run
FOREIGN_COLUMNS = 100_000  # columns of a table that another program wrote
CELL_BYTES = 1_000  # length of a cell or of a column's name in a CSV file
VALUE = 1e30  # size of a recorded value, in SI units
TIME_S = 1e10  # size of a time stamp: three centuries, enough for stamps that count from 1970
STEP_S = 1e-9  # least time between two samples
GAP_S = 3_600.0  # most time between two samples of a run that a model integrates over time
DURATION_S = 1e5  # length of a run that a model integrates over time
LINKS = 1_000  # links of an arm, and so numbers of joints and links
ELEMENTS = 1_000  # elements of a hysteresis operator, rows of its mesh, turning points before a run
POSES = 500_000  # poses of an arm that a table drives
STEPS = 1_000  # steps of the integrator for each pose of a drive
FILLING_S = 1_000_000  # length of the filling of an arm
ANGLE_DEG = 180.0  # size of a commanded angle of a designed experiment
STARTS = 10_000  # starts of a fit
