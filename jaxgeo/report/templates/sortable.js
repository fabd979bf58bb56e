  function sortable(table) {
    const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
    const sort = function (column) {
      const up = heads[column].getAttribute("aria-sort") !== "ascending";
      heads.forEach((head, i) => i === column ? head.setAttribute("aria-sort", up ? "ascending" : "descending") : head.removeAttribute("aria-sort"));
      const key = (row) => row.cells[column].dataset.key;
      const rows = [...body.rows].sort(function (a, b) {
        const p = key(a), q = key(b);
        if (p === "" || q === "") return (p === "") - (q === "");
        const order = isNaN(p) || isNaN(q) ? p.localeCompare(q, undefined, { numeric: true }) : p - q;
        return up ? order : -order;
      });
      body.append(...rows);
    };
    heads.forEach(function (head, i) {
      head.addEventListener("click", () => sort(i));
      head.addEventListener("keydown", (event) => { if (event.key === "Enter") sort(i); });
    });
  }
  document.querySelectorAll("table.fixes").forEach(sortable);

