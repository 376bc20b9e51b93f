"""Track the state of an arm and the wind from late and noisy measurements."""

from ._arm import (
    Air as Air,
    Bias as Bias,
    Held as Held,
    TrackedArm as TrackedArm,
    tracked_arm as tracked_arm,
)
from ._filter import (
    Gaussian as Gaussian,
    Innovation as Innovation,
    measured as measured,
    moved as moved,
    root_of_sum as root_of_sum,
    smoothed as smoothed,
)
from ._live import (
    Heard as Heard,
    LiveRows as LiveRows,
    followed_live as followed_live,
    lines_of as lines_of,
)
from ._report import (
    TRACK_FILES as TRACK_FILES,
    TRACK_HEADINGS as TRACK_HEADINGS,
    TrackFiles as TrackFiles,
    band_columns as band_columns,
    change_sentence as change_sentence,
    end_columns as end_columns,
    estimate_columns as estimate_columns,
    estimate_definition as estimate_definition,
    heard_facts as heard_facts,
    heard_line as heard_line,
    track_facts as track_facts,
    track_figure as track_figure,
    track_notes as track_notes,
    track_rows as track_rows,
    track_sections as track_sections,
)
from ._rounds import (
    GATE as GATE,
    Events as Events,
    Filtered as Filtered,
    Followed as Followed,
    Learning as Learning,
    Motion as Motion,
    Suspected as Suspected,
    System as System,
    Watch as Watch,
    filtered as filtered,
    followed_by as followed_by,
    predicted as predicted,
    rested as rested,
    smoothed_states as smoothed_states,
    watching as watching,
)
from ._track import (
    Change as Change,
    States as States,
    Track as Track,
    Unknown as Unknown,
    track as track,
    usual_torque as usual_torque,
)
from ._tracker import DelayedFilter as DelayedFilter, Tracker as Tracker
from ._verdict import (
    BAND as BAND,
    Cause as Cause,
    TrackVerdict as TrackVerdict,
    judge as judge,
    nees as nees,
    unseen as unseen,
    usual_places as usual_places,
)
