"""What the files of a fit are called, and how they are known again."""

RESULT = "result.json"
PAGE = "report.html"

# Written into each picture and page: how a later fit knows one of an earlier from a person's.
SIGNATURE = "giajax fit"
