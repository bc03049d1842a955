"""Questions to a field: texts to things and Gaussians, decided once in the scene and drawn in views.

``LanguageField`` has a method for each question; its answers, catalogues, labels, edits and comparisons have writers
beside them. A question changes nothing.
"""

from scoup.query.answer import Answer, ExpressionAnswer
from scoup.query.answer_files import AnswerFiles
from scoup.query.ask import answers_of, asked_things
from scoup.query.boxes import OrientedBox
from scoup.query.catalog import draw_things, related_objects, save_catalog
from scoup.query.comparison import compare, save_comparison
from scoup.query.drawings import drawing, placed_atoms
from scoup.query.edits import SceneEdit, SplatTable
from scoup.query.expression import Expression, parse_expression
from scoup.query.field_view import FieldView
from scoup.query.frame import Frame
from scoup.query.labels import GaussianLabels, LabelFiles
from scoup.query.language_field import LanguageField, build
from scoup.query.phrase_data import phrase_data
from scoup.query.presence import Certainty
from scoup.query.question import Question, TextVectors, warn_of_another_model
from scoup.query.refinement import refine
from scoup.query.select import Reshaping
from scoup.query.thing_judge import AskedThings, ThingIndex
from scoup.query.thing_names import named_things
from scoup.query.things import Place, Thing
from scoup.query.view_answer import ViewAnswer
from scoup.query.votes import level_thresholds, select_by_relevancy

__all__ = [
    "Answer",
    "AnswerFiles",
    "AskedThings",
    "Certainty",
    "Expression",
    "ExpressionAnswer",
    "FieldView",
    "Frame",
    "GaussianLabels",
    "LabelFiles",
    "LanguageField",
    "OrientedBox",
    "Place",
    "Question",
    "Reshaping",
    "SceneEdit",
    "SplatTable",
    "TextVectors",
    "Thing",
    "ThingIndex",
    "ViewAnswer",
    "answers_of",
    "asked_things",
    "build",
    "compare",
    "draw_things",
    "drawing",
    "level_thresholds",
    "named_things",
    "parse_expression",
    "phrase_data",
    "placed_atoms",
    "refine",
    "related_objects",
    "save_catalog",
    "save_comparison",
    "select_by_relevancy",
    "warn_of_another_model",
]
