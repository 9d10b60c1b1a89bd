"""The style sheet of report.html."""

CSS = """
:root{--bg:#fbfaf8;--fg:#222;--dim:#666;--line:#ddd;--card:#fff;--accent:#c4621a}
@media(prefers-color-scheme:dark){:root{--bg:#17171a;--fg:#e6e4e0;--dim:#999;--line:#333;--card:#202024;--accent:#f0954a}}
*{box-sizing:border-box}
body{margin:0;background:var(--bg);color:var(--fg);font:15px/1.5 system-ui,sans-serif}
main{max-width:1200px;margin:0 auto;padding:1.5rem}
h1{font-size:1.8rem;margin:.5rem 0 1rem}
h2{font-size:1.05rem;margin:2rem 0 .7rem;color:var(--accent);font-weight:600}
.tiles{display:flex;flex-wrap:wrap;gap:.7rem}
.tiles div{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:.6rem 1rem}
.tiles b{display:block;font-size:1.2rem}
.tiles span{color:var(--dim);font-size:.8rem}
.warnings{background:var(--card);border-left:4px solid var(--accent);margin:1rem 0;padding:.6rem 1rem .6rem 2rem}
.triple{display:grid;grid-template-columns:repeat(3,1fr);gap:.6rem;margin-bottom:.6rem}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(210px,1fr));gap:.6rem;margin-bottom:.6rem}
figure{margin:0}
img{width:100%;height:auto;border-radius:6px;display:block;background:#000}
figcaption{color:var(--dim);font-size:.8rem;padding:.2rem 0}
svg{width:min(320px,100%);display:block}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.3rem .9rem .3rem 0;text-align:left;border-bottom:1px solid var(--line)}
th{color:var(--dim);font-weight:500}
.swatch{display:inline-block;width:2.2em;height:1.2em;border-radius:4px;
  border:1px solid var(--line);vertical-align:middle}
.bars{display:grid;max-width:640px;
  grid-template-columns:max-content 1fr max-content;gap:.25rem .8rem;align-items:center}
.bars i{height:.7em;background:var(--accent);border-radius:3px;min-width:2px}
summary{cursor:pointer}
@media print{body{background:#fff}}
"""
